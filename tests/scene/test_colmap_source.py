"""Cameras by COLMAP on their way into a scene; what cannot be registered is named."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from instok3d.cli import main
from instok3d.errors import NotEnoughMemoryError
from instok3d.geometry.cameras import intrinsics_from_field_of_view, invert_rigid
from instok3d.photos.loading import PhotoSet, read_photos
from instok3d.scene import colmap_source
from instok3d.scene.colmap_source import colmap_geometry
from instok3d.scene.supplied import TYPICAL_DEPTH
from instok3d.sfm.colmap import RegisteredPhoto
from instok3d.sfm.matches import PhotoMatches
from instok3d.types import Views
from made_model import made_model, made_photos
from plane_backbone import PlaneBackbone, PlaneConfig
from textured_room import save_photos

pytest.importorskip("pycolmap", reason="pycolmap is not installed")

HEIGHT, WIDTH, SIDE = 40, 60, 32
UNIT = 40.0
"""The depth of everything in the world that the registration below is in."""


def registered(number: int, rng: torch.Generator) -> RegisteredPhoto:
    """A camera in a world of its own, in a large unit, that sees a plane."""
    cam_from_world = torch.eye(4, dtype=torch.float64)
    cam_from_world[:3, 3] = torch.tensor([-3.0 * number, 1.0, 2.0])
    angle = torch.tensor(1.2, dtype=torch.float64)
    return RegisteredPhoto(
        number,
        cam_from_world,
        intrinsics_from_field_of_view(angle, HEIGHT, WIDTH),
        pixels=torch.rand(80, 2, generator=rng) * torch.tensor([WIDTH, HEIGHT]),
        depths=torch.full((80,), UNIT),
    )


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    return made_photos(tmp_path / "photos", count=4)


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch, rng: torch.Generator):
    """Makes COLMAP register these photos; nothing is matched."""
    matches = PhotoMatches((), {}, "features 7")
    monkeypatch.setattr(colmap_source, "best_features", lambda device: (None, []))
    monkeypatch.setattr(colmap_source, "match_photos", lambda *rest: matches)

    def these(numbers: list[int]) -> None:
        found = [registered(number, rng) for number in numbers]
        monkeypatch.setattr(colmap_source, "register_photos", lambda *rest: found)

    return these


def read(photos: Path) -> PhotoSet:
    return read_photos(photos, height=SIDE, width=SIDE)


def test_cameras_and_fitted_depth_come_out_in_the_lengths_of_a_room(photos: Path, register):
    register([0, 1, 2, 3])
    found = colmap_geometry(PlaneBackbone(PlaneConfig()), read(photos), "cpu")
    views = found.supplied.views
    assert views.depths is not None
    assert views.cam_from_world is not None
    assert views.intrinsics is not None
    assert found.notes == []
    assert float(views.depths.median()) == pytest.approx(TYPICAL_DEPTH)
    # The plane of the backbone is bent; the points say that it is flat, and how far away.
    assert float((views.depths / TYPICAL_DEPTH).log().abs().mean()) < 0.03
    centres = invert_rigid(views.cam_from_world[0])[:, :3, 3]
    step = 3 * TYPICAL_DEPTH / UNIT
    torch.testing.assert_close(
        centres[1:, 0] - centres[:-1, 0], torch.full((3,), step), atol=0.01, rtol=0
    )
    # 60 x 40 is cropped to its middle, which becomes 32 x 32.
    focal = 0.5 * WIDTH / torch.tensor(0.6).tan() * SIDE / HEIGHT
    torch.testing.assert_close(views.intrinsics[0, :, 0, 0], focal.expand(4))
    assert not found.supplied.unsure.any()


def test_photos_that_do_not_register_are_left_out_and_named(
    tmp_path: Path, photos: Path, register, capsys: pytest.CaptureFixture[str]
):
    register([1, 3])
    room, model = tmp_path / "room.itk", made_model(tmp_path / "m.safetensors")
    words = ["reconstruct", str(photos), "-o", str(room), "--model", str(model), "--refine", "0"]
    assert main([*words, "--geometry", "colmap"]) == 0
    said = capsys.readouterr()
    note = "left out, as COLMAP could not register them with the other photos: 0.png, 2.png"
    assert f"note: {note}" in said.err
    scene = instok3d.load(room)
    assert [view.file for view in scene.views] == ["1.png", "3.png"]
    assert note in scene.warnings
    assert (scene.units, scene.frame) == ("arbitrary", "first camera")
    torch.testing.assert_close(scene.cameras.cam_from_world[0], torch.eye(4))
    step = float(invert_rigid(scene.cameras.cam_from_world)[1, 0, 3])
    assert step == pytest.approx(6 * TYPICAL_DEPTH / UNIT, abs=0.02)
    assert scene.provenance.geometry.startswith("colmap (pycolmap ")
    assert scene.provenance.geometry.endswith(", features 7)")
    assert f"cameras and depth: {scene.provenance.geometry}" in said.out


def test_photos_that_cannot_be_registered_are_refused_with_advice(
    tmp_path: Path, photos: Path, register, capsys: pytest.CaptureFixture[str]
):
    register([])
    room, model = tmp_path / "room.itk", made_model(tmp_path / "m.safetensors")
    words = ["reconstruct", "-o", str(room), "--model", str(model), "--geometry", "colmap"]
    assert main([*words, str(photos)]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("instok3d: no two of these 4 photos could be registered by COLMAP: take")
    assert main([*words, str(photos / "0.png")]) == 2
    assert "geometry 'colmap' needs two photos or more, got 1" in capsys.readouterr().err
    assert not room.exists()


def test_given_cameras_and_colmap_exclude_each_other(
    tmp_path: Path, photos: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["reconstruct", str(photos), "-o", str(tmp_path / "room.itk"), "--geometry", "colmap"]
    assert main([*words, "--cameras", "transforms.json"]) == 2
    assert "cameras are given (--cameras): leave out one of the two" in capsys.readouterr().err


def test_without_pycolmap_the_command_says_how_to_get_it(
    tmp_path: Path,
    photos: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setitem(__import__("sys").modules, "pycolmap", None)
    room = tmp_path / "room.itk"
    assert main(["reconstruct", str(photos), "-o", str(room), "--geometry", "colmap"]) == 2
    assert "pip install 'instok3d[sfm]'" in capsys.readouterr().err.splitlines()[-1]


def test_too_little_memory_is_refused_before_photos_are_matched(
    photos: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("instok3d.model.memory.available_bytes", lambda device: 1_000_000)
    monkeypatch.setattr("instok3d.model.memory.resident_bytes", lambda: 0)
    monkeypatch.setattr(colmap_source, "match_photos", lambda *rest: pytest.fail("matched"))
    with pytest.raises(NotEnoughMemoryError, match=r"take --geometry nano"):
        colmap_geometry(PlaneBackbone(PlaneConfig()), read(photos), "cpu")


def test_a_backbone_that_is_unsure_leaves_the_depth_unknown(photos: Path, register):
    class UnsureLeft(PlaneBackbone):
        def forward(self, views: Views):
            geometry = super().forward(views)
            left = torch.arange(SIDE) < SIDE // 4
            confidences = torch.where(left, 0.1, 1.0).expand_as(geometry.confidences)
            return replace(geometry, confidences=confidences)

    register([0, 2])
    found = colmap_geometry(UnsureLeft(PlaneConfig()), read(photos), "cpu")
    assert found.supplied.unsure[..., : SIDE // 4].all()
    assert not found.supplied.unsure[..., SIDE // 4 :].any()
    assert found.supplied.views.depths is not None
    assert torch.equal(found.supplied.views.depths[0] == 0, found.supplied.unsure)


def test_photos_of_a_patterned_room_become_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("instok3d.sfm.matches.find_spec", lambda name: None)
    save_photos(tmp_path / "photos", count=4)
    scene = instok3d.reconstruct(
        tmp_path / "photos",
        model=made_model(tmp_path / "m.safetensors"),
        geometry="colmap",
        refine=0,
    )
    assert len(scene.views) == 4
    assert any("XFeat is not installed" in line for line in scene.warnings)
    assert "SIFT of pycolmap" in scene.provenance.geometry
    assert scene.render().colors.isfinite().all()
