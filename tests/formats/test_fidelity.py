"""What comes back from each format renders as what was written."""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from instok3d.formats.registry import ExportOptions, export_scene, read_splats
from instok3d.scene.scene import Scene
from instok3d.types import check_gaussians
from splat_scenes import corner_scene, furnished_scene, picture, psnr

GATES_DB = {
    ".ply": 60,
    ".glb": 60,
    ".compressed.ply": 36,
    ".splat": 40,
    ".spz": 47,
    ".ksplat": 45,
    ".sog": 55,
}
CENTERS = [(0.7, -0.4, 0.0), (-1.0, 0.3, 0.5)]
KEEPS_ROWS = (".ply", ".glb", ".splat", ".spz", ".ksplat")


@contextlib.contextmanager
def extras_needed() -> Iterator[None]:
    """Skips where a format needs a package that is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("suffix", GATES_DB)
@pytest.mark.parametrize("scene", [corner_scene(), furnished_scene()], ids=["corners", "room"])
def test_read_back_and_rendered(tmp_path: Path, suffix: str, scene: Scene):
    with extras_needed():
        export_scene(scene, tmp_path / f"a{suffix}")
    splats = read_splats(tmp_path / f"a{suffix}")
    check_gaussians(splats.gaussians, suffix)
    assert len(splats.gaussians.means) == len(scene.gaussians.means)
    wanted = scene.gaussians
    if suffix == ".splat":  # which says nothing of how colours change with the view
        sh = wanted.sh[:, :1]
        wanted = replace(wanted, sh=sh)
    for center in CENTERS:
        db = psnr(picture(splats.gaussians, center), picture(wanted, center))
        assert db >= GATES_DB[suffix], f"{db:.1f} dB from {center}"


@pytest.mark.parametrize("suffix", KEEPS_ROWS)
def test_rows_stay_in_their_order(tmp_path: Path, suffix: str):
    scene = furnished_scene(200)
    export_scene(scene, tmp_path / f"a{suffix}")
    again = read_splats(tmp_path / f"a{suffix}").gaussians
    torch.testing.assert_close(again.means, scene.gaussians.means, atol=1e-4, rtol=0)


def test_compressed_rows_stay_within_their_objects(tmp_path: Path):
    scene = furnished_scene(800)
    export_scene(scene, tmp_path / "a.compressed.ply")
    again = read_splats(tmp_path / "a.compressed.ply").gaussians
    for item in scene.objects:
        start, count = item.gaussian_range
        mine = again.means[start : start + count].sum(dim=0)
        torch.testing.assert_close(mine, scene.part(item.id).means.sum(dim=0), atol=0.2, rtol=0)


@pytest.mark.parametrize("suffix", GATES_DB)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_degrees_of_colour(tmp_path: Path, suffix: str, degree: int):
    scene = furnished_scene(300, sh_count=16)
    with extras_needed():
        export_scene(scene, tmp_path / f"a{suffix}", ExportOptions(sh_degree=degree))
    sh = read_splats(tmp_path / f"a{suffix}").gaussians.sh
    most = {".splat": 0, ".ksplat": 2}.get(suffix, 3)
    assert sh.shape[1] == (min(degree, most) + 1) ** 2


@pytest.mark.parametrize("suffix", GATES_DB)
def test_no_gaussians_and_extreme_ones_are_written_or_refused(
    tmp_path: Path, suffix: str, empty_scene: Scene
):
    nothing = replace(empty_scene, gaussians=empty_scene.gaussians.rows(slice(0, 0)))
    if suffix == ".sog":
        pytest.skip("it cannot hold a scene without Gaussians, and says so")
    with extras_needed():
        export_scene(nothing, tmp_path / f"a{suffix}")
    assert len(read_splats(tmp_path / f"a{suffix}").gaussians.means) == 0
    scene = corner_scene()
    wild = replace(
        scene.gaussians,
        scales=torch.tensor([1e-30, 1e-9, 1e5]).expand(8, 3).contiguous(),
        opacities=torch.tensor([0.0, 1.0]).repeat(4),
        sh=scene.gaussians.sh * 1e6,
    )
    export_scene(replace(scene, gaussians=wild), tmp_path / f"b{suffix}")
    check_gaussians(read_splats(tmp_path / f"b{suffix}").gaussians, suffix)
