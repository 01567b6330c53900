"""Files that other programs wrote, and our files in other programs' readers."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from instok3d.formats.registry import export_scene, read_splats
from instok3d.formats.upright import FLIP
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from splat_scenes import CORNER_COLORS, corner_scene, eight_corners, picture, psnr

NODE = Path(os.environ.get("INSTOK3D_NODE_MODULES", "node_modules"))
SPLAT_TRANSFORM = NODE / "@playcanvas/splat-transform/bin/cli.mjs"


def test_three_gaussians_are_the_same_in_each_format(shared: Path):
    folder = shared / "data/gaussian_files/metalsplatter"
    ply, splat, spz = (
        read_splats(folder / f"test-splat.3-points-from-train.{end}").gaussians
        for end in ("ply", "splat", "spz")
    )
    torch.testing.assert_close(splat.means, ply.means)
    torch.testing.assert_close(splat.scales, ply.scales, rtol=1e-4, atol=0)
    torch.testing.assert_close(splat.sh[:, 0], ply.sh[:, 0].clamp(-1.77, 1.77), atol=0.02, rtol=0)
    torch.testing.assert_close(splat.opacities, ply.opacities, atol=0.004, rtol=0)
    torch.testing.assert_close(spz.means, ply.means, atol=3e-4, rtol=0)


@pytest.mark.parametrize("name", ["biker.compressed.ply", "biker.spz", "test.ply"])
def test_playcanvas_files_are_read(shared: Path, name: str):
    if name.endswith("spz"):
        pytest.importorskip("zstandard")
    splats = read_splats(shared / "data/gaussian_files/playcanvas" / name)
    assert len(splats.gaussians.means) > 20
    assert not splats.notes


def colored_places(means: np.ndarray, constant: np.ndarray) -> None:
    """Each of the eight corners has its own colour, wherever its row is."""
    wanted = eight_corners()
    for place, color in zip(wanted.means.numpy(), CORNER_COLORS.numpy(), strict=True):
        row = np.abs(means - place).sum(axis=1).argmin()
        np.testing.assert_allclose(means[row], place, atol=0.01)
        np.testing.assert_allclose(0.5 + SH_CONSTANT * constant[row], color, atol=0.02)


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz", ".compressed.ply", ".ksplat"])
def test_gaussforge_reads_ours(tmp_path: Path, suffix: str):
    gaussforge = pytest.importorskip("gaussforge")
    export_scene(corner_scene(), tmp_path / f"a{suffix}")
    data = (tmp_path / f"a{suffix}").read_bytes()
    found = gaussforge.GaussForge().convert(data, suffix[1:], "ply")
    assert "error" not in found, found
    (tmp_path / "b.ply").write_bytes(found["data"])
    again = read_splats(tmp_path / "b.ply").gaussians
    # It stores the axes of .spz unchanged, where the specification has y up and z backward.
    means = again.means @ FLIP if suffix == ".spz" else again.means
    colored_places(means.numpy(), again.sh[:, 0].numpy())


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".compressed.ply"])
def test_gsply_reads_ours(tmp_path: Path, suffix: str):
    gsply = pytest.importorskip("gsply")
    export_scene(corner_scene(), tmp_path / f"a{suffix}")
    read = gsply.read_spz if suffix == ".spz" else gsply.plyread
    found = read(str(tmp_path / f"a{suffix}"))
    means = found.means @ FLIP.numpy() if suffix == ".spz" else found.means
    colored_places(means, np.asarray(found.sh0).reshape(-1, 3))


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz", ".compressed.ply", ".ksplat", ".sog"])
def test_splat_transform_reads_ours(tmp_path: Path, suffix: str):
    if shutil.which("node") is None or not SPLAT_TRANSFORM.is_file():
        pytest.skip("splat-transform is not here: npm install @playcanvas/splat-transform and set "
                    "INSTOK3D_NODE_MODULES")  # fmt: skip
    if suffix == ".sog":
        pytest.importorskip("gaussforge")
    export_scene(corner_scene(), tmp_path / f"a{suffix}")
    words = ["node", str(SPLAT_TRANSFORM), "-q", "-g", "cpu", str(tmp_path / f"a{suffix}")]
    subprocess.run([*words, str(tmp_path / "b.ply")], check=True, capture_output=True)
    again = read_splats(tmp_path / "b.ply").gaussians
    colored_places(again.means.numpy(), again.sh[:, 0].numpy())
    assert psnr(picture(again), picture(eight_corners())) >= (25 if suffix == ".splat" else 36)


def test_both_bikers_are_the_same(shared: Path):
    folder = shared / "data/gaussian_files/playcanvas"
    pytest.importorskip("zstandard")
    first, second = (
        read_splats(folder / f"biker.{end}").gaussians for end in ("compressed.ply", "spz")
    )
    assert len(first.means) == len(second.means)
    # In other orders, but with the same cloud: its quantiles along each axis.
    shares = torch.linspace(0.05, 0.95, 7)
    for axis in range(3):
        one, two = first.means[:, axis].quantile(shares), second.means[:, axis].quantile(shares)
        torch.testing.assert_close(one, two, atol=0.02, rtol=0)
