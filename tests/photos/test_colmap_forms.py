"""COLMAP models as other programs, editors and cut transfers leave them."""

import os
import struct
import warnings
from pathlib import Path

import pytest
import torch

from colmap_models import write_colmap
from instok3d.photos.colmap_files import find_model, read_model

LENS = {1: ("PINHOLE", 60, 40, [50.0, 50.0, 30.0, 20.0])}
POSE = "1 0 0 0 0.5 0 0"
CAMERAS = "1 PINHOLE 60 40 50 50 30 20\n"


def write_text(folder: Path, images: str, cameras: str = CAMERAS) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(cameras)
    (folder / "images.txt").write_text(images)
    return folder


def write_named(folder: Path, *names: str, suffix: str = ".bin") -> Path:
    write_colmap(folder, LENS, [(name, torch.eye(4).double(), 1) for name in names], suffix)
    return folder


def names(folder: Path) -> list[str]:
    return [image.name for image in read_model(folder)]


IMAGES = [f"{k} {POSE} 1 {name}" for k, name in enumerate(["a.jpg", "b c.jpg", "12", "d"], 1)]
POINTS = "1.5 2.5 -1 3.5 4.5 7"


@pytest.mark.parametrize(
    "lines",
    [
        IMAGES,  # without the lines of points
        [line for image in IMAGES for line in (image, "")],
        [line for image in IMAGES for line in (image, POINTS)],
        [IMAGES[0], POINTS, IMAGES[1], "", IMAGES[2], IMAGES[3], POINTS],
        ["# Image list", "", IMAGES[0], POINTS, "", IMAGES[1], "# more", POINTS, *IMAGES[2:]],
        [f"\t{image} \r" for image in IMAGES],
    ],
)
def test_every_image_is_read_with_or_without_its_line_of_points(tmp_path, lines):
    write_text(tmp_path, "\n".join(lines))
    assert names(tmp_path) == ["12", "a.jpg", "b c.jpg", "d"]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([POINTS], "line '1.5 2.5 -1 3.5 4.5 7' is neither an image nor points"),
        ([IMAGES[0], POINTS, POINTS], "is neither an image nor points"),
        ([IMAGES[0], "1 2"], "is neither an image nor points"),
        ([IMAGES[0], f"2 {POSE} 1"], "is neither an image nor points"),  # no name
        ([IMAGES[0], "", IMAGES[0]], "the number 1 is used twice"),
        (["# Number of images: 3, mean observations per image: 2", *IMAGES[:2]],
         "says that it holds 3 images, but lists 2"),
        ([f"1 nan 0 0 0 0 0 0 1 {'a.jpg'}"], "quaternion of length nan"),
        ([f"1 {POSE} 9 a.jpg"], "has camera 9, which is not there"),
    ],
)  # fmt: skip
def test_text_that_would_lose_images_is_refused(tmp_path, lines, message):
    write_text(tmp_path, "\n".join(lines))
    with pytest.raises(ValueError, match=message):
        read_model(tmp_path)


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        (2 * CAMERAS, "the number 1 is used twice"),
        (f"# Number of cameras: 2\n{CAMERAS}", "says that it holds 2 cameras, but lists 1"),
        ("1 PINHOLE 60 40 50 50 30\n", "the lens model PINHOLE with 3 parameters"),
        ("1 PINHOLE 60\n", "damaged"),
    ],
)
def test_text_that_would_lose_cameras_is_refused(tmp_path, cameras, message):
    with pytest.raises(ValueError, match=message):
        read_model(write_text(tmp_path, IMAGES[0], cameras))


@pytest.mark.parametrize("name", ["images.bin", "cameras.bin"])
def test_binary_files_with_more_than_they_promise_are_refused(tmp_path, name):
    write_named(tmp_path, "a.jpg", "b.jpg")
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(struct.pack("<Q", 1) + data[8:] + b"\0")
    with pytest.raises(ValueError, match=r"bytes follow the 1 (images|cameras) that the file"):
        read_model(tmp_path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path, encoding):
    write_text(tmp_path, "\n".join(IMAGES))
    for file in tmp_path.iterdir():
        file.write_bytes(file.read_text().encode(encoding))
    assert len(names(tmp_path)) == 4


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_names_that_are_no_text_are_those_of_their_files(tmp_path, suffix):
    write_named(tmp_path, "x.jpg", suffix=suffix)
    file = tmp_path / f"images{suffix}"
    file.write_bytes(file.read_bytes().replace(b"x.jpg", b"\xff.jpg"))
    assert os.fsencode(names(tmp_path)[0]) == b"\xff.jpg"


def test_line_ends_of_unicode_are_parts_of_names(tmp_path):
    write_text(tmp_path, f"1 {POSE} 1 a\x85b\u2028c.jpg\n")
    assert names(tmp_path) == ["a\x85b\u2028c.jpg"]


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_letter_case_of_the_files_does_not_count(tmp_path, suffix):
    write_named(tmp_path / "Sparse/0", "a.jpg", suffix=suffix)
    for name in ("cameras", "images"):
        file = tmp_path / f"Sparse/0/{name}{suffix}"
        file.rename(file.with_name(file.name.title()))
    model = find_model(tmp_path)
    assert model == tmp_path / "Sparse/0"
    assert names(model) == ["a.jpg"]


@pytest.mark.parametrize("place", ["sparse", "colmap/sparse", "."])
def test_of_several_models_the_largest_is_taken_and_told(tmp_path, place):
    write_named(tmp_path / place / "0", "1.jpg", "7.jpg")
    write_named(tmp_path / place / "1", "1.jpg", "2.jpg", "3.jpg", suffix=".txt")
    write_named(tmp_path / place / "10", "8.jpg")
    with pytest.warns(UserWarning, match="COLMAP models") as caught:
        assert find_model(tmp_path) == tmp_path / place / "1"
    (message,) = [str(warning.message) for warning in caught]
    for part in ("3 COLMAP models", "0 with 2 photos", "1 with 3 photos", "10 with 1 photos",
                 "1 is used, which leaves out 2 photos: 7.jpg, 8.jpg"):  # fmt: skip
        assert part in message


def test_equal_models_are_told_and_the_first_is_taken(tmp_path):
    for place in ("sparse", "sparse/0", "sparse/1"):
        write_named(tmp_path / place, "1.jpg")
    with pytest.warns(UserWarning, match=r"3 COLMAP models .*sparse/0 is used$"):
        assert find_model(tmp_path) == tmp_path / "sparse/0"


def test_one_model_or_none_needs_no_word(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert find_model(tmp_path) is None
        assert find_model(tmp_path / "nowhere") is None
        (tmp_path / "sparse/1").mkdir(parents=True)
        write_named(tmp_path / "sparse/0", "1.jpg")
        assert find_model(tmp_path) == tmp_path / "sparse/0"


def test_a_damaged_model_among_several_is_refused(tmp_path):
    write_named(tmp_path / "sparse/0", "1.jpg")
    write_text(tmp_path / "sparse/1", "1 2 3")
    with pytest.raises(ValueError, match=r"sparse/1/images\.txt is damaged"):
        find_model(tmp_path)
