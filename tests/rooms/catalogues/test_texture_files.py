"""Texture files on floors, walls, wood and cloth."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from glb_files import write_textures
from instok3d.rooms.catalogues.texture_files import TextureCatalogue, load_texture, use_of
from instok3d.rooms.materials import Maker, Style

GREY = np.full((8, 8, 3), 128, np.uint8)
CHEQUERED = np.kron(np.indices((2, 2)).sum(0) % 2, np.ones((4, 4)))[..., None] * np.full(3, 255)


def test_a_use_is_drawn_from_its_files_with_a_tint(tmp_path):
    folder = write_textures(tmp_path, {"oak": ("wood", GREY), "tiles": ("floor", GREY)})
    catalogue, rng = TextureCatalogue.open(folder), np.random.default_rng(0)
    drawn = [catalogue.draw(rng, "wood", plain=False, held_out=False) for _ in range(5)]
    assert {entry.stem for _, entry in filter(None, drawn)} == {"oak"}
    means = [texture.mean() for texture, _ in filter(None, drawn)]
    assert np.ptp(means) > 5
    assert catalogue.draw(rng, "cloth", plain=False, held_out=False) is None


def test_easy_rooms_get_no_patterns_and_only_transfer_rooms_what_is_held_out(tmp_path):
    names = {"chess": ("floor", CHEQUERED.astype(np.uint8)), "marble_slab": ("floor", GREY)}
    catalogue, rng = (
        TextureCatalogue.open(write_textures(tmp_path, names)),
        np.random.default_rng(0),
    )

    def stems(plain: bool, held_out: bool) -> set[str]:
        drawn = [catalogue.draw(rng, "floor", plain=plain, held_out=held_out) for _ in range(20)]
        return {entry.stem for _, entry in filter(None, drawn)}

    assert stems(False, True) == {"chess", "marble_slab"}
    assert stems(False, False) == {"chess"}
    assert stems(True, True) == {"marble_slab"}
    assert stems(True, False) == set()


def test_the_shorter_side_of_a_long_picture_is_repeated(tmp_path):
    stripe = np.zeros((4, 12, 3), np.uint8)
    stripe[:2] = 255  # one bright and one dark stripe, three times in a square
    Image.fromarray(stripe).save(tmp_path / "long.png")
    column = load_texture(tmp_path / "long.png")[:, 0, 0] > 128
    assert (np.diff(column.astype(int)) != 0).sum() == 5


def test_parquet_is_a_floor_and_a_wall_of_bricks_is_a_wall():
    assert use_of("wood", "pine_PARQUET_2") == "floor"
    assert use_of("wood", "pine") == "wood"
    assert use_of("floor", "brick_wall") == "wall"
    assert use_of("ceiling", "x") == "ceiling"


def test_half_of_the_woods_are_files_and_without_files_nothing_is_drawn(tmp_path):
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 0] = 200
    catalogue = TextureCatalogue.open(write_textures(tmp_path, {"oak": ("wood", red)}))
    woods = [Maker(np.random.default_rng(i), Style(textures=catalogue)).wood() for i in range(100)]
    assert 30 < sum(wood.texture[..., 1:].max() == 0 for wood in woods) < 70
    bare = Maker(np.random.default_rng(0))
    assert bare.from_file("wood", (1, 2)) is None
    assert bare.rng.random() == np.random.default_rng(0).random()


def test_files_of_other_licences_and_kinds_are_counted(tmp_path):
    names = dict.fromkeys(("a", "b", "c"), ("wall", GREY))
    folder = write_textures(tmp_path, names)
    records = json.loads((folder / "catalog.json").read_text())
    records[0]["license"] = "GPL-2+ / CC-BY-3.0"
    records[1]["kind"] = "sky"
    (folder / "catalog.json").write_text(json.dumps(records))
    catalogue = TextureCatalogue.open(folder)
    assert [entry.stem for entry in catalogue.entries] == ["c"]
    assert catalogue.left_out == {
        "licence other than CC0, CC-BY, MIT": 1,
        "kind other than floor, wall, wood, cloth": 1,
    }


def test_a_damaged_or_missing_texture_is_named(tmp_path):
    folder = write_textures(tmp_path, {"a": ("wall", GREY)})
    whole = (folder / "a.png").read_bytes()
    for data in (b"", whole[:50], b"RIFF" + whole):
        (folder / "a.png").write_bytes(data)
        with pytest.raises(ValueError, match=r"a\.png is damaged .* take it out of the catalogue"):
            TextureCatalogue.open(folder)
        load_texture.cache_clear()
    (folder / "a.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"there is no file .*a\.png"):
        TextureCatalogue.open(folder)


def test_the_textures_beside_the_project_have_their_uses(shared: Path):
    folder = shared / "data" / "textures"
    if not folder.is_dir():
        pytest.skip("the texture files are not here")
    catalogue = TextureCatalogue.open(folder)
    assert {entry.use for entry in catalogue.entries} == {"floor", "wall", "wood"}
    assert {entry.license for entry in catalogue.entries} == {"MIT"}
    assert catalogue.left_out == {"licence other than CC0, CC-BY, MIT": 20}
