"""Pictures for people: their colours and how sheets are laid out."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.pictures import (
    Section,
    color_picture,
    contact_sheet,
    depth_picture,
    id_picture,
    save_png,
    titled_rows,
)


def test_sheet_enlarges_by_a_whole_factor_and_keeps_colours():
    red = np.full((10, 20, 3), (255, 0, 0), np.uint8)
    sheet = contact_sheet(titled_rows([[red, red], [red]], ["one", "two"]))
    # 10 rows become 130, 20 columns 260; gaps of 6 around, a line of 16 under the first row.
    assert sheet.size == (6 + 2 * 266, 6 + (130 + 16 + 6) + (130 + 6))
    assert sheet.getpixel((100, 100)) == (255, 0, 0)
    assert sheet.getpixel((100, 6 + 152 + 20)) == (255, 0, 0)
    assert sheet.getpixel((400, 6 + 152 + 20)) == (255, 255, 255)


def test_cells_go_on_in_the_next_row_under_their_title():
    grey = np.full((8, 8, 3), 99, np.uint8)
    section = Section("title", [grey] * 3, ["a", "b", "c"])
    sheet = contact_sheet([section], cell_height=8, columns=2)
    assert sheet.size == (6 + 2 * 14, 6 + 16 + 2 * (8 + 16 + 6))
    assert sheet.getpixel((6, 22 + 30)) == (99, 99, 99)
    assert sheet.getpixel((6 + 14, 22 + 30)) == (255, 255, 255)


def test_a_section_without_cells_keeps_its_title_and_a_sheet_without_cells_is_refused():
    one = Section("", [np.zeros((8, 8, 3), np.uint8)])
    assert contact_sheet([one, Section("none", [])], cell_height=8).size == (20, 6 + 14 + 16)
    with pytest.raises(ValueError, match="at least one picture"):
        contact_sheet([Section("none", [])])


def test_void_is_black_and_ids_differ():
    picture = id_picture(torch.tensor([[0, 1, 2], [3, 40, -1]]))
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[1, 2].tolist() == [64, 64, 64]
    assert len({tuple(p) for p in picture.reshape(-1, 3).tolist()}) == 6
    assert not id_picture(torch.zeros(2, 2, dtype=torch.long)).any()


def test_pictures_are_cut_to_bytes():
    image = torch.tensor([-1.0, 0.5, 2.0]).view(1, 1, 3).expand(3, 1, 3)
    assert color_picture(image)[0, :, 0].tolist() == [0, 128, 255]
    depths = torch.tensor([[0.0, 1.0, 2.0, 9.0]])
    assert depth_picture(depths, farthest=2.0)[0, :, 0].tolist() == [0, 128, 0, 0]


def test_a_saved_picture_comes_back_pixel_by_pixel(tmp_path: Path):
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    save_png(Image.fromarray(pixels), tmp_path / "a.png")
    with Image.open(tmp_path / "a.png", formats=["PNG"]) as picture:
        assert np.array_equal(np.asarray(picture), pixels)
