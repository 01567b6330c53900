"""glTF and USD: named parts, y up, and nothing lost."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from instok3d.formats.registry import ExportOptions, export_scene, read_splats
from instok3d.formats.upright import FLIP, rigid_turn, y_up
from instok3d.geometry.moving import move_gaussians
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import Vertical
from instok3d.types import Gaussians
from splat_scenes import CORNER_COLORS, corner_scene, furnished_scene, picture, psnr

Z_UP = Vertical((0.0, 0.0, 1.0), "given cameras", 0.9)


def read_usd(path: Path) -> dict[str, Gaussians]:
    """The Gaussians of each prim, by OpenUSD alone, in the file's axes."""
    usd = pytest.importorskip("pxr.Usd")
    geometry = pytest.importorskip("pxr.UsdGeom")
    stage = usd.Stage.Open(str(path))
    assert geometry.GetStageUpAxis(stage) == "Y"
    parts = {}
    for prim in stage.GetDefaultPrim().GetChildren():
        assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
        positions, scales, opacities, harmonics = (
            torch.from_numpy(np.array(prim.GetAttribute(name).Get(), np.float32))
            for name in ("positions", "scales", "opacities",
                         "radiance:sphericalHarmonicsCoefficients")
        )  # fmt: skip
        quats = [[q.GetReal(), *q.GetImaginary()] for q in prim.GetAttribute("orientations").Get()]
        degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
        parts[prim.GetName()] = Gaussians(
            means=positions.view(-1, 3), quats=torch.tensor(quats).view(-1, 4),
            scales=scales.view(-1, 3), opacities=opacities,
            sh=harmonics.view(-1, (degree + 1) ** 2, 3),
            anchor_index=torch.zeros(len(quats), dtype=torch.long),
        )  # fmt: skip
    return parts


def test_usd_has_a_prim_for_each_object_and_renders_the_same(tmp_path: Path):
    scene = furnished_scene()
    pytest.importorskip("pxr.Usd")
    export_scene(scene, tmp_path / "a.usdz")
    assert [file.name for file in tmp_path.iterdir()] == ["a.usdz"]
    parts = read_usd(tmp_path / "a.usdz")
    assert list(parts) == ["object_1", "object_2", "rest"]
    whole = move_gaussians(Gaussians.concatenate(list(parts.values())), rigid_turn(FLIP))
    assert psnr(picture(whole), picture(scene.gaussians)) >= 60


@pytest.mark.parametrize("suffix", [".glb", ".usdz"])
def test_a_z_up_world_stands_upright(tmp_path: Path, suffix: str):
    scene = replace(corner_scene(), vertical=Z_UP, frame="given cameras")
    wanted = scene.gaussians.means @ y_up(Z_UP).mT
    if suffix == ".usdz":
        pytest.importorskip("pxr.Usd")
    export_scene(scene, tmp_path / f"a{suffix}")
    if suffix == ".usdz":
        means = read_usd(tmp_path / "a.usdz")["rest"].means
    else:
        splats = read_splats(tmp_path / "a.glb")
        assert splats.up == pytest.approx((0, -1, 0))
        means = splats.gaussians.means @ FLIP.mT
    torch.testing.assert_close(means, wanted)
    torch.testing.assert_close(means[:, 1], scene.gaussians.means[:, 2])


def test_gltf_keeps_groups_labels_and_points_for_others(tmp_path: Path):
    scene = furnished_scene()
    first = replace(scene.objects[0], label="Red box")
    scene = replace(scene, objects=(first, *scene.objects[1:]))
    export_scene(scene, tmp_path / "a.glb")
    splats = read_splats(tmp_path / "a.glb")
    assert torch.equal(splats.object_ids, scene.object_ids())
    assert splats.labels == {1: "Red box"}
    data = (tmp_path / "a.glb").read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert content["extensionsUsed"] == ["KHR_gaussian_splatting"]
    assert [node["name"] for node in content["nodes"]] == ["object#1", "object#2", "rest"]
    primitive = content["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert "COLOR_0" in primitive["attributes"]


def test_corners_of_a_gltf_by_its_bytes(tmp_path: Path):
    """Positions and colours read by hand: x right, y up, z towards the viewer."""
    export_scene(corner_scene(), tmp_path / "a.glb", ExportOptions(sh_degree=0))
    data = (tmp_path / "a.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    content, buffer = json.loads(data[20 : 20 + length]), data[28 + length :]
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    assert len(attributes) == 6
    views = content["bufferViews"]
    places = np.frombuffer(buffer, "<f4", 24, views[attributes["POSITION"]]["byteOffset"])
    colors = np.frombuffer(buffer, "u1", 32, views[attributes["COLOR_0"]]["byteOffset"])
    places, colors = places.reshape(8, 3), colors.reshape(8, 4) / 255
    np.testing.assert_allclose(colors[:, :3], CORNER_COLORS, atol=0.003)
    assert (colors[places[:, 0] > 0, 0] > 0.5).all()  # red grows to the right
    assert (colors[places[:, 1] < 0, 1] > 0.5).all()  # green downwards
    assert (colors[places[:, 2] < -4, 2] > 0.5).all()  # blue away from the viewer


@pytest.mark.parametrize("damage", [
    lambda c: c["nodes"][0].update(translation=[1, 0, 0]),
    lambda c: c["accessors"][0].update(count=10**9),
    lambda c: c["accessors"][2].update(componentType=5120),
    lambda c: c["bufferViews"][0].update(byteOffset=2**40),
    lambda c: c["nodes"][0].update(mesh=99),
    lambda c: c["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"),
    lambda c: c.pop("meshes"),
])  # fmt: skip
def test_a_gltf_that_lies_is_refused(tmp_path: Path, scene: Scene, damage):
    export_scene(scene, tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    content = json.loads(data[20 : 20 + length])
    damage(content)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    total = len(data) - length + len(text)
    (tmp_path / "a.glb").write_bytes(
        data[:8] + total.to_bytes(4, "little") + len(text).to_bytes(4, "little") + data[16:20]
        + text + data[20 + length :]
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"a\.glb is damaged"):
        read_splats(tmp_path / "a.glb")
