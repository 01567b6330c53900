"""Focal lengths by EXIF with the default model, on the demo's photos (60 degrees: 26.5 mm)."""

from importlib.resources import files
from pathlib import Path

import pytest
import torch
from PIL import Image

from instok3d.backbones.nano.backbone import NanoBackbone
from instok3d.model.files import DEFAULT_MODEL, load_model
from instok3d.photos.loading import PhotoSet, read_photos
from instok3d.scene.checked_geometry import CheckedGeometry, checked_geometry

PHOTOS = Path(str(files("instok3d") / "assets" / "demo"))
TRUE_MM = 27
FOCAL_35MM, DETAILS = 0xA405, 0x8769


@pytest.fixture(scope="module")
def backbone() -> NanoBackbone:
    if not (DEFAULT_MODEL.is_file() and PHOTOS.is_dir()):
        pytest.skip("the default model and the demo's photos are not in this tree")
    found = load_model(None).eval().backbone
    assert isinstance(found, NanoBackbone)
    return found


def stating(folder: Path, focal_mm: int | None, count: int = 3) -> PhotoSet:
    """Some photos of the demo which say that they were taken at a focal length (35 mm film)."""
    exif = Image.Exif()
    if focal_mm is not None:
        exif.get_ifd(DETAILS)[FOCAL_35MM] = focal_mm
    for photo in sorted(PHOTOS.iterdir())[:count]:
        Image.open(photo).save(folder / photo.name, quality=95, exif=exif)
    return read_photos(folder, height=128, width=128)


@torch.no_grad()
def seen(backbone: NanoBackbone, photos: PhotoSet) -> CheckedGeometry:
    return checked_geometry(backbone, photos, "cpu")


def test_a_focal_length_that_fits_is_taken(backbone: NanoBackbone, tmp_path: Path):
    photos = stating(tmp_path, TRUE_MM)
    found = seen(backbone, photos)
    assert found.notes == []
    assert found.photos.intrinsics_source == "exif"
    assert photos.views.intrinsics is not None
    torch.testing.assert_close(found.geometry.cameras.intrinsics, photos.views.intrinsics)


@pytest.mark.parametrize("factor", [0.5, 2])
def test_one_of_a_photo_that_was_cropped_gives_way_to_what_the_photos_show(
    backbone: NanoBackbone, tmp_path: Path, factor: float
):
    (tmp_path / "stating").mkdir()
    (tmp_path / "silent").mkdir()
    found = seen(backbone, stating(tmp_path / "stating", round(factor * TRUE_MM)))
    silent = seen(backbone, stating(tmp_path / "silent", None))
    assert torch.equal(found.geometry.depths, silent.geometry.depths)
    assert torch.equal(found.geometry.cameras.intrinsics, silent.geometry.cameras.intrinsics)
    assert found.photos.intrinsics_source is found.photos.views.intrinsics is None
    (note,) = found.notes
    stated = round(factor * TRUE_MM) / 43.2666 * 256 * 2**0.5  # of photos with 256 pixels a side
    assert f"EXIF; {stated:.0f} pixels in photo_1.jpg" in note
    solved = 2 * float(silent.geometry.cameras.intrinsics[0, 0, 0, 0])
    assert f"{solved:.0f} pixels were found" in note
    assert solved == pytest.approx(221.7, rel=0.03)


def test_a_single_photo_cannot_speak_against_its_focal_length(
    backbone: NanoBackbone, tmp_path: Path
):
    found = seen(backbone, stating(tmp_path, 2 * TRUE_MM, count=1))
    assert found.notes == []
    assert found.photos.intrinsics_source == "exif"
