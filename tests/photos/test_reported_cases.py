"""Inputs that users of neighbouring projects reported: read whole, or refused with the reason."""

import warnings
from pathlib import Path

import pytest

from instok3d.photos.loading import PhotoSet, read_photos


@pytest.fixture
def cases(shared: Path) -> Path:
    folder = shared / "data/reported_cases"
    if not folder.is_dir():
        pytest.skip("the reported cases are not here")
    return folder


def read(source: Path | str) -> PhotoSet:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read_photos(source, height=32, width=32)


@pytest.mark.parametrize(
    "case",
    ["01", "12", "13/noext_JPG", "13/noext_jpeg", "13/noext_webp", "13/noextwh_JPG",
     "13/noextwh_jpeg", "13/noextwh_webp", "14/bom", "14/colbom", "16"],
)  # fmt: skip
def test_every_photo_is_read_with_its_camera(cases, case):
    photos = read(cases / case)
    assert [name.partition(".")[0] for name in photos.names] == [f"photo_{k}" for k in range(1, 5)]
    assert photos.intrinsics_source == "cameras"
    assert photos.warnings == ()


def test_the_larger_of_two_models_is_used_with_a_note(cases):
    photos = read(cases / "02")
    assert len(photos.names) == 6
    (note,) = photos.warnings
    assert "sparse/0 with 2 photos, sparse/1 with 6 photos" in note


@pytest.mark.parametrize(
    ("case", "message"),
    [("04", r"moves pixels by 43% of the image diagonal"), ("19", "too far for single precision")],
)
def test_what_cannot_be_used_is_refused(cases, case, message):
    with pytest.raises(ValueError, match=message):
        read(cases / case)


def test_names_with_a_tilde_are_files(cases, monkeypatch):
    monkeypatch.chdir(cases / "06")
    assert read("~photo_1.jpg").names == ("~photo_1.jpg",)


@pytest.mark.parametrize("name", ["base.ts", "base.3gp"])
def test_videos_of_other_kinds_are_read(cases, name):
    pytest.importorskip("imageio_ffmpeg")
    assert len(read(cases / "20" / name).names) == 8
