import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from instok3d.datasets.scannet.id_maps import (
    MOST_TIMES_THE_PICTURE,
    IdMaps,
    largest_instance,
    read_id_png,
    write_id_maps,
)
from scannet_files import huge_png, id_map, png_bytes

SIZE = (6, 8)


def test_maps_are_found_by_frame_number(tmp_path: Path):
    path = tmp_path / "labels.zip"
    labels = {number: 300 * id_map(number, SIZE) for number in (0, 7, 120)}
    write_id_maps(path, "label-filt", labels)
    with IdMaps(path, "label-filt") as maps:
        assert maps.last_frame == 120
        for number, ids in labels.items():
            np.testing.assert_array_equal(maps.read(number, 48), ids)
        assert maps.read(1, 48) is None


def test_instance_maps_have_eight_bits(tmp_path: Path):
    path = tmp_path / "instances.zip"
    write_id_maps(path, "instance-filt", {3: np.full(SIZE, 255)})
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == ["instance-filt/3.png"]
        with archive.open("instance-filt/3.png") as stream:
            assert Image.open(stream).mode == "L"
    with pytest.raises(ValueError, match="instance id 256"):
        write_id_maps(path, "instance-filt", {3: np.full(SIZE, 256)})


def test_padded_names_below_another_folder_are_found_too(tmp_path: Path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("scene0000_00/instance-filt/000012.png", png_bytes(np.eye(3, dtype="u1")))
        archive.writestr("scene0000_00/instance-filt/readme.txt", "")
    with IdMaps(path, "instance-filt") as maps:
        np.testing.assert_array_equal(maps.read(12, 48), np.eye(3))


def test_the_wrong_archive_is_refused(tmp_path: Path):
    path = tmp_path / "a.zip"
    write_id_maps(path, "label-filt", {0: id_map(0, SIZE)})
    with pytest.raises(ValueError, match=r"no instance-filt/<frame>\.png but 'label-filt/0\.png"):
        IdMaps(path, "instance-filt")
    with zipfile.ZipFile(path, "w"):
        pass
    with pytest.raises(ValueError, match="but nothing"):
        IdMaps(path, "instance-filt")


def test_a_cut_or_foreign_archive_is_refused(tmp_path: Path):
    path = tmp_path / "a.zip"
    write_id_maps(path, "label-filt", {0: id_map(0, SIZE)})
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(ValueError, match="is damaged"):
        IdMaps(path, "label-filt")
    with pytest.raises(FileNotFoundError, match="no archive"):
        IdMaps(tmp_path / "b.zip", "label-filt")


def test_a_damaged_map_is_named(tmp_path: Path):
    path = tmp_path / "a.zip"
    write_id_maps(path, "label-filt", {0: id_map(0, SIZE)})
    data = bytearray(path.read_bytes())
    data[data.index(b"IDAT") + 8] ^= 0xFF
    path.write_bytes(data)
    with (
        IdMaps(path, "label-filt") as maps,
        pytest.raises(ValueError, match=r"label-filt/0\.png is damaged"),
    ):
        maps.read(0, 48)


@pytest.mark.parametrize(
    ("at", "patch", "message"),
    [
        (6, b"\xff\x00", "is damaged"),  # needs version 25.5
        (8, b"\x01\x00", r"0\.png is damaged"),  # encrypted
        (10, b"\x63\x00", r"0\.png is damaged"),  # compressed in another way
    ],
)
def test_an_archive_of_another_kind_is_refused(tmp_path: Path, at: int, patch: bytes, message: str):
    path = tmp_path / "a.zip"
    write_id_maps(path, "label-filt", {0: id_map(0, SIZE)})
    data = bytearray(path.read_bytes())
    start = data.index(b"PK\x01\x02") + at
    data[start : start + 2] = patch
    path.write_bytes(data)
    with pytest.raises(ValueError, match=message), IdMaps(path, "label-filt") as maps:
        maps.read(0, 48)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is damaged or"),
        (b"GIF89a", "is damaged or"),
        (huge_png(), "is damaged or"),
        (png_bytes(np.zeros((4, 4, 3), np.uint8)), "RGB pixels, wanted"),
    ],
)
def test_only_pictures_of_ids_are_read(data: bytes, message: str):
    with pytest.raises(ValueError, match=message) as error:
        read_id_png(data, "x", 48)
    assert "0x" not in str(error.value)  # no address in memory, which means nothing to a reader


def test_instances_are_one_more_than_the_ids_of_the_aggregation(tmp_path: Path):
    path = tmp_path / "a.aggregation.json"
    path.write_text('{"segGroups": [{"id": 0, "label": "wall"}, {"id": 4, "label": "bed"}]}')
    assert largest_instance(path) == 5
    path.write_text('{"segGroups": []}')
    assert largest_instance(path) == 0
    path.write_text("[]")
    with pytest.raises(ValueError, match="damaged"):
        largest_instance(path)


def test_a_map_much_larger_than_its_picture_is_not_unpacked(tmp_path: Path):
    path, zeros = tmp_path / "a.zip", np.zeros((3000, 3000), np.uint8)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("label-filt/0.png", bytes(30_000_000))
        archive.writestr("label-filt/1.png", png_bytes(zeros))
    with IdMaps(path, "label-filt") as maps:
        tracemalloc.start()
        with pytest.raises(ValueError, match=r"label-filt/0\.png unpacks to more than"):
            maps.read(0, 48)
        with pytest.raises(ValueError, match="3000 x 3000 pixels, its picture only 48 in all"):
            maps.read(1, 48)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2_000_000  # a fifteenth of the first
        assert maps.read(1, 9_000_000 // MOST_TIMES_THE_PICTURE) is not None
