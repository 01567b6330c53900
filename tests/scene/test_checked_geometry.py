"""Both checks with the default model, on rendered and real photos."""

from importlib.resources import files
from pathlib import Path

import pytest
import torch
from PIL import Image

from instok3d.backbones.nano.backbone import NanoBackbone
from instok3d.model.files import DEFAULT_MODEL, load_model
from instok3d.photos.loading import PhotoSet, read_photos
from instok3d.scene.checked_geometry import check_photos, checked_geometry

DEMO = Path(str(files("instok3d") / "assets" / "demo"))


@pytest.fixture(scope="module")
def backbone() -> NanoBackbone:
    if not (DEFAULT_MODEL.is_file() and DEMO.is_dir()):
        pytest.skip("the default model and the demo's photos are not in this tree")
    found = load_model(None).eval().backbone
    assert isinstance(found, NanoBackbone)
    return found


def read(source: Path | list[Path], cameras: Path | None = None) -> PhotoSet:
    return read_photos(source, height=128, width=128, cameras=cameras)


@torch.no_grad()
def check(backbone: NanoBackbone, photos: PhotoSet) -> tuple[list[str], list[str]]:
    """Names of the photos that are kept, and the notes."""
    checked = check_photos(backbone, photos, "cpu")
    return list(checked.photos.names), checked.notes


def test_photos_of_the_demo_all_belong_together(backbone: NanoBackbone):
    kept, notes = check(backbone, read(DEMO))
    assert (len(kept), notes) == (len(list(DEMO.iterdir())), [])


@pytest.mark.parametrize("kind", ["black", "white", "noise"])
def test_a_photo_that_shows_nothing_is_left_out(
    backbone: NanoBackbone, tmp_path: Path, kind: str, rng: torch.Generator
):
    noise = (torch.rand(128, 128, 3, generator=rng) * 255).byte().numpy()
    odd = tmp_path / "odd.png"
    picture = Image.fromarray(noise) if kind == "noise" else Image.new("RGB", (128, 128), kind)
    picture.save(odd)
    kept, notes = check(backbone, read([odd, *sorted(DEMO.iterdir())[:3]]))
    assert [Path(name).name for name in kept] == ["photo_1.jpg", "photo_2.jpg", "photo_3.jpg"]
    (note,) = notes
    assert note.startswith("left out")
    assert note.endswith("odd.png")


def test_the_good_photos_come_out_as_if_the_odd_one_had_not_been_there(
    backbone: NanoBackbone, tmp_path: Path
):
    black = tmp_path / "black.png"
    Image.new("RGB", (128, 128)).save(black)
    good = sorted(DEMO.iterdir())[:2]
    with torch.no_grad():
        clean = checked_geometry(backbone, read(good), "cpu")
        spoilt = checked_geometry(backbone, read([black, *good]), "cpu")
        alone = backbone(read(good).views)
    assert clean.notes == []
    assert spoilt.photos.sha256 == clean.photos.sha256
    assert "black.png" in spoilt.notes[0]
    for seen in (clean, spoilt):
        assert torch.equal(seen.geometry.depths, alone.depths)
        assert torch.equal(seen.geometry.cameras.cam_from_world, alone.cameras.cam_from_world)


def test_a_single_photo_is_kept_with_a_note_if_it_is_black(backbone: NanoBackbone, tmp_path: Path):
    black = tmp_path / "black.png"
    Image.new("RGB", (128, 128)).save(black)
    kept, (note,) = check(backbone, read([black]))
    assert kept == ["black.png"]
    assert note.startswith("nothing can be made out in any photo")
    assert check(backbone, read([DEMO / "photo_1.jpg"])) == (["photo_1.jpg"], [])


def test_two_photos_of_different_rooms_are_noted(backbone: NanoBackbone, shared: Path):
    kept, (note,) = check(backbone, read(shared / "data/reported_cases/18/nooverlap"))
    assert kept == ["p0.png", "p1.png"]
    assert "no two of these photos match: p0.png, p1.png" in note


@torch.no_grad()
def test_a_photo_whose_matches_fit_no_camera_is_left_out(backbone: NanoBackbone, shared: Path):
    # A table with chairs that look alike: the third photo shows others of them from elsewhere.
    folder = shared / "data/unposed_photos/iggt_demo9"
    photos = [folder / name for name in ("00000.jpg", "01947.jpg", "01082.jpg")]
    kept, _ = check(backbone, read(photos))
    assert len(kept) == 3  # by the number of matches alone
    found = checked_geometry(backbone, read(photos), "cpu")
    assert found.photos.names == ("00000.jpg", "01947.jpg")
    (note,) = found.notes
    assert note.startswith("left out, as no cameras fit")
    assert note.endswith(": 01082.jpg")
    alone = backbone(read(photos[:2]).views)
    assert torch.equal(found.geometry.depths, alone.depths)


@pytest.mark.parametrize(
    ("case", "why"),
    [
        ("11", None),
        ("17/w2c", "the matrices were inverted"),
        ("17/cvaxes", "y and z of the camera axes were reversed"),
    ],
)
def test_reported_cameras_are_checked_against_their_photos(
    backbone: NanoBackbone, shared: Path, case: str, why: str | None
):
    folder = shared / "data/reported_cases" / case
    kept, notes = check(backbone, read(folder, folder / "transforms.json"))
    assert len(kept) == 4
    if why is None:
        assert notes == []
    else:
        (note,) = notes
        assert "given cameras contradict the photos" in note
        assert why in note


@pytest.mark.parametrize("name", ["open3d_livingroom", "threedmatch_studyroom"])
def test_real_rooms_fit_their_own_cameras(backbone: NanoBackbone, shared: Path, name: str):
    folder = shared / "data/rgbd_posed" / name
    kept, notes = check(backbone, read(folder, folder / "scene.json"))
    assert (len(kept), notes) == (5, [])


@pytest.mark.slow
def test_no_real_set_of_photos_loses_one(backbone: NanoBackbone, shared: Path):
    for folder in sorted((shared / "data/unposed_photos").iterdir()):
        photos = read(folder)
        kept, notes = check(backbone, photos)
        assert (kept, notes) == (list(photos.names), []), folder.name
