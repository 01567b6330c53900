"""Cameras and depth of another backbone: what it gives reaches the scene, and what it cannot."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
import torch
from jaxtyping import Float
from safetensors.torch import save_file
from torch import Tensor

import instok3d
from instok3d.backbones.base import BackboneConfig, GeometryBackbone
from instok3d.backbones.depth_anything3 import (
    PUBLISHED as DA3_NAMES,
)
from instok3d.backbones.depth_anything3 import (
    DepthAnything3Backbone,
    DepthAnything3Config,
)
from instok3d.backbones.vggt import VGGTConfig
from instok3d.cli import main
from instok3d.cli import reconstruct as command
from instok3d.errors import MissingWeightsError
from instok3d.geometry.cameras import (
    intrinsics_from_field_of_view,
    project,
    transform_points,
)
from instok3d.model import memory
from instok3d.photos.loading import PhotoSet, read_photos
from instok3d.scene import geometry_source
from instok3d.scene.geometry_source import (
    CHOICES,
    PUBLISHED,
    GeometrySource,
    find_source,
    supplied_geometry,
)
from instok3d.scene.supplied import TYPICAL_DEPTH, unsure_patches
from instok3d.types import Geometry, Views
from instok3d.weights import catalogue
from instok3d.weights.cache import place_of
from made_model import made_model, made_photos
from plane_backbone import PlaneBackbone, PlaneConfig
from tiny_vggt import TINY_VGGT, tiny_vggt

SIDE = 32


class UnsureLeft(PlaneBackbone):
    """Far less sure of the left quarter of every photo, and wrong there."""

    def forward(self, views: Views) -> Geometry:
        geometry = super().forward(views)
        left = torch.arange(geometry.depths.shape[-1]) < geometry.depths.shape[-1] // 4
        return replace(
            geometry,
            depths=torch.where(left, 100.0, geometry.depths),
            confidences=torch.where(left, 1.0, 9.0).expand_as(geometry.confidences),
        )


class Broken(PlaneBackbone):
    """Says that its cameras stand nowhere."""

    def forward(self, views: Views) -> Geometry:
        geometry = super().forward(views)
        cameras = geometry.cameras.map(lambda values: values * torch.nan)
        return replace(geometry, cameras=cameras)


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without any weights."""
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    return made_photos(tmp_path / "photos")


def read(photos: Path) -> PhotoSet:
    return read_photos(photos, height=SIDE, width=SIDE)


def source_of(backbone: GeometryBackbone) -> GeometrySource:
    source, notes = find_source(backbone, posed=False)
    assert isinstance(source, GeometrySource)
    assert notes == []
    return source


def install(
    monkeypatch: pytest.MonkeyPatch, name: str, content: bytes, config: BackboneConfig
) -> str:
    """Puts weights on the machine as if they were the published ones; gives their SHA-256."""
    digest = hashlib.sha256(content).hexdigest()
    entries = [
        replace(entry, sha256=digest) if entry.name == name else entry
        for entry in catalogue.CATALOGUE
    ]
    monkeypatch.setattr(catalogue, "CATALOGUE", tuple(entries))
    known = geometry_source._config
    monkeypatch.setattr(
        geometry_source, "_config", lambda asked: config if asked == name else known(asked)
    )
    place = place_of(catalogue.find_entry(name))
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(content)
    return digest


def tiny_vggt_weights(folder: Path) -> tuple[bytes, VGGTConfig]:
    config = replace(TINY_VGGT, geometry_from="depths")
    save_file(tiny_vggt(geometry_from="depths").state_dict(), folder / "tiny.safetensors")
    return (folder / "tiny.safetensors").read_bytes(), config


def test_cameras_come_out_as_the_backbone_gave_them_up_to_scale(tmp_path: Path, photos: Path):
    plane = PlaneBackbone(PlaneConfig())
    scene = instok3d.reconstruct(
        photos, model=made_model(tmp_path / "m.safetensors"), geometry=plane, refine=0
    )
    side = PlaneConfig().image_side
    alone = plane(Views(torch.zeros(1, 2, 3, side, side)))
    step = 0.1 * TYPICAL_DEPTH / float(alone.depths.median())
    expected = torch.eye(4).repeat(2, 1, 1)
    expected[1, 0, 3] = -step
    torch.testing.assert_close(scene.cameras.cam_from_world, expected, atol=2e-3, rtol=0)
    intrinsics = intrinsics_from_field_of_view(torch.ones(2), SIDE, SIDE)
    torch.testing.assert_close(scene.cameras.intrinsics, intrinsics)
    assert (scene.units, scene.frame) == ("arbitrary", "first camera")


def test_the_unit_of_the_backbone_changes_nothing(photos: Path):
    class Larger(PlaneBackbone):
        def forward(self, views: Views) -> Geometry:
            geometry = super().forward(views)
            cameras = geometry.cameras.cam_from_world.clone()
            cameras[..., :3, 3] *= 1000
            return replace(
                geometry,
                depths=1000 * geometry.depths,
                cameras=replace(geometry.cameras, cam_from_world=cameras),
            )

    small, large = (
        supplied_geometry(source_of(kind(PlaneConfig())), read(photos), "cpu").views
        for kind in (PlaneBackbone, Larger)
    )
    for name in ("depths", "cam_from_world", "intrinsics"):
        torch.testing.assert_close(getattr(small, name), getattr(large, name))
    assert small.depths is not None
    assert float(small.depths.median()) == pytest.approx(TYPICAL_DEPTH)


def test_the_backbone_sees_the_same_part_of_the_photos_at_its_own_size(photos: Path):
    seen = []

    class Watching(PlaneBackbone):
        def forward(self, views: Views) -> Geometry:
            seen.append(views)
            return super().forward(views)

    photo_set = read(photos)
    supplied_geometry(source_of(Watching(PlaneConfig())), photo_set, "cpu")
    (views,) = seen
    assert views.images.shape == (1, 2, 3, 128, 128)
    small = torch.nn.functional.interpolate(views.images[0], size=(SIDE, SIDE), mode="area")
    assert float((small - photo_set.views.images[0]).abs().mean()) < 0.02
    assert (views.intrinsics, views.cam_from_world, views.depths) == (None, None, None)


def test_unsure_depth_is_unknown_and_the_rest_is_kept(photos: Path):
    supplied = supplied_geometry(source_of(UnsureLeft(PlaneConfig())), read(photos), "cpu")
    assert supplied.unsure[..., : SIDE // 4].all()
    assert not supplied.unsure[..., SIDE // 4 :].any()
    depths = supplied.views.depths
    assert depths is not None
    assert torch.equal(depths[0] == 0, supplied.unsure)
    assert float(depths[0][~supplied.unsure].median()) == pytest.approx(TYPICAL_DEPTH)


def columns_of(scene: instok3d.Scene) -> Float[Tensor, "view anchor"]:
    """Pixel columns at which each view sees the anchors."""
    points = scene.tokens.positions.expand(len(scene.views), -1, -1)
    return project(
        transform_points(scene.cameras.cam_from_world, points), scene.cameras.intrinsics
    )[..., 0]


def test_unsure_depth_seeds_no_anchor_and_no_gaussian(tmp_path: Path, photos: Path):
    model = made_model(tmp_path / "m.safetensors")
    scene = instok3d.reconstruct(photos, model=model, geometry=UnsureLeft(PlaneConfig()), refine=0)
    sure = instok3d.reconstruct(
        photos, model=model, geometry=PlaneBackbone(PlaneConfig()), refine=0
    )
    assert 0 < len(scene.tokens.positions) < len(sure.tokens.positions)
    assert (columns_of(scene) >= SIDE // 4).any(dim=0).all()
    assert (columns_of(sure) < SIDE // 4).all(dim=0).any()
    assert int(scene.gaussians.anchor_index.max()) < len(scene.tokens.assignment)
    assert scene.tokens.assignment.shape[0] == len(scene.tokens.positions)
    assert scene.render().colors.isfinite().all()


def test_a_patch_is_unsure_if_most_of_its_pixels_are():
    unsure = torch.zeros(2, 4, 4, dtype=torch.bool)
    unsure[0, :2, :2] = True
    unsure[1, 2:, 2:] = torch.tensor([[True, True], [False, False]])
    assert unsure_patches(unsure, 2).tolist() == [True] + 7 * [False]
    assert unsure_patches(unsure[:0], 2).shape == (0,)


def test_given_cameras_and_depth_stand_beside_another_backbone(photos: Path):
    photo_set = read(photos)
    cam_from_world = torch.eye(4).repeat(1, 2, 1, 1)
    cam_from_world[0, :, 0, 3] = torch.tensor([5.0, 4.0])  # ten times the plane's own step
    depths = torch.zeros(1, 2, SIDE, SIDE)
    given = replace(
        photo_set.views,
        intrinsics=intrinsics_from_field_of_view(torch.full((1, 2), 0.9), SIDE, SIDE),
        cam_from_world=cam_from_world,
    )
    plane = source_of(PlaneBackbone(PlaneConfig()))
    views = supplied_geometry(plane, replace(photo_set, views=given), "cpu").views
    assert views.cam_from_world is cam_from_world
    assert views.intrinsics is given.intrinsics
    assert views.depths is not None
    assert 20 < float(views.depths.min()) < float(views.depths.max()) < 30.1

    depths[..., : SIDE // 4] = 3.0
    unsure = source_of(UnsureLeft(PlaneConfig()))
    posed = replace(photo_set, views=replace(given, depths=depths))
    supplied = supplied_geometry(unsure, posed, "cpu")
    assert supplied.views.depths is not None
    assert (supplied.views.depths[..., : SIDE // 4] == 3).all()
    assert not supplied.unsure.any()


def test_an_answer_that_is_not_finite_is_refused(photos: Path):
    with pytest.raises(ValueError, match=r"Broken finds no geometry in these photos.*take"):
        supplied_geometry(source_of(Broken(PlaneConfig())), read(photos), "cpu")


@pytest.mark.usefixtures("plane")
def test_the_provenance_names_the_backbone(tmp_path: Path, photos: Path):
    model = made_model(tmp_path / "m.safetensors")
    made = [
        instok3d.reconstruct(photos, model=model, geometry=geometry, refine=0).provenance
        for geometry in ("nano", PlaneBackbone(PlaneConfig()))
    ]
    assert [(each.geometry, each.geometry_sha256) for each in made] == [("nano", ""), ("plane", "")]


def test_the_command_takes_what_python_takes():
    hints = get_type_hints(command.run, include_extras=False)
    assert set(get_args(hints["geometry"])) == set(CHOICES)
    with pytest.raises(ValueError, match=r"geometry must be one of nano, da3-small.*got 'nono'"):
        find_source("nono", posed=False)


def test_vggt_goes_from_a_file_to_a_scene(
    tmp_path: Path, photos: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    digest = install(monkeypatch, "vggt-1b", *tiny_vggt_weights(tmp_path))
    model, room = made_model(tmp_path / "m.safetensors"), tmp_path / "room.itk"
    words = ["reconstruct", str(photos), "-o", str(room), "--model", str(model), "--refine", "0"]
    assert main([*words, "--geometry", "auto"]) == 0
    said = capsys.readouterr()
    assert f"cameras and depth: vggt-1b ({digest[:12]})" in said.out
    assert "note: geometry: vggt-1b, the best whose weights are on this machine" in said.err
    scene = instok3d.load(room)
    assert (scene.provenance.geometry, scene.provenance.geometry_sha256) == ("vggt-1b", digest)
    assert any(line.startswith("geometry: vggt-1b") for line in scene.warnings)


def test_depth_anything_3_goes_from_a_file_to_a_scene(
    tmp_path: Path, photos: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("depth_anything_3", reason="the package depth-anything-3 is not installed")
    config = DepthAnything3Config(size="tiny")
    torch.manual_seed(0)
    state = DepthAnything3Backbone(config).net.state_dict()
    file = tmp_path / "tiny.safetensors"
    save_file({f"{DA3_NAMES}{name}": value.clone() for name, value in state.items()}, file)
    digest = install(monkeypatch, "da3-small", file.read_bytes(), config)
    scene = instok3d.reconstruct(
        photos, model=made_model(tmp_path / "m.safetensors"), geometry="da3-small", refine=0
    )
    assert (scene.provenance.geometry, scene.provenance.geometry_sha256) == ("da3-small", digest)
    assert scene.render().colors.isfinite().all()


@pytest.mark.parametrize(
    ("there", "installed", "chosen"),
    [
        ((), True, "nano"),
        (("da3-small",), True, "da3-small"),
        (("da3-small", "da3-base"), True, "da3-base"),
        (("da3-small", "vggt-1b"), True, "vggt-1b"),
        (("da3-small", "da3-base"), False, "nano"),
        (("vggt-1b", "da3-base"), False, "vggt-1b"),
    ],
)
def test_auto_takes_the_best_that_is_there(
    monkeypatch: pytest.MonkeyPatch, there: tuple[str, ...], installed: bool, chosen: str
):
    monkeypatch.setattr("instok3d.backbones.depth_anything3.is_installed", lambda: installed)
    for name in there:
        install(monkeypatch, name, name.encode(), PlaneConfig())
    source, (note,) = find_source("auto", posed=False)
    assert (source.name if source else "nano") == chosen
    assert note.startswith(f"geometry: {chosen}, ")
    assert find_source("auto", posed=True) == (None, [])
    assert find_source("nano", posed=False) == (None, [])


@pytest.mark.parametrize("name", PUBLISHED)
def test_missing_weights_say_how_to_get_them(
    name: str, tmp_path: Path, photos: Path, capsys: pytest.CaptureFixture
):
    with pytest.raises(MissingWeightsError):
        find_source(name, posed=False)
    room = tmp_path / "room.itk"
    assert main(["reconstruct", str(photos), "-o", str(room), "--geometry", name]) == 4
    last = capsys.readouterr().err.splitlines()[-1]
    assert f"weights {name} are not on this machine: run 'instok3d models pull {name}'" in last
    assert not room.exists()


def test_given_without_cameras_is_refused(
    tmp_path: Path, photos: Path, capsys: pytest.CaptureFixture
):
    room = tmp_path / "room.itk"
    assert main(["reconstruct", str(photos), "-o", str(room), "--geometry", "given"]) == 2
    assert "geometry 'given' needs cameras" in capsys.readouterr().err
    assert find_source("given", posed=True) == (None, [])


def test_memory_is_refused_for_the_larger_network_before_it_is_loaded(
    tmp_path: Path, photos: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    install(monkeypatch, "vggt-1b", b"weights", VGGTConfig(geometry_from="depths"))
    monkeypatch.setattr(geometry_source, "_load", lambda *rest: pytest.fail("loaded"))
    monkeypatch.setattr(memory, "available_bytes", lambda device: 2_000_000_000)
    monkeypatch.setattr(memory, "resident_bytes", lambda: 0)
    room, model = tmp_path / "room.itk", made_model(tmp_path / "m.safetensors")
    words = ["reconstruct", str(photos), "-o", str(room), "--model", str(model)]
    assert main([*words, "--geometry", "vggt-1b"]) == 3
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("instok3d: 2 views of 518 x 518 pixels are predicted to need")
    assert not room.exists()
