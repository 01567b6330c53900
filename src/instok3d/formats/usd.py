"""USD packages of ParticleField3DGaussianSplat prims: one for each object, y up."""

import re
from importlib import import_module
from pathlib import Path
from typing import Any

from instok3d.files import replacing
from instok3d.formats.parts import with_degree, y_up_parts
from instok3d.formats.registry import ExportOptions
from instok3d.formats.statements import scene_comments
from instok3d.formats.upright import y_up
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians

ROOT = "/scene"
SIGMAS = 3.0
"""How many standard deviations the extent of a prim reaches beyond its centres."""


def write_usd(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians, turned so that y is up, atomically.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
        ModuleNotFoundError: OpenUSD 26.03 or newer is not installed.
    """
    usd, geometry, utilities = _openusd()
    with replacing(path, overwrite=options.overwrite) as part:
        layer = part.with_name("scene.usdc")
        stage = usd.Stage.CreateNew(str(layer))
        geometry.SetStageUpAxis(stage, geometry.Tokens.y)
        geometry.SetStageMetersPerUnit(stage, 1.0)
        stage.SetMetadata("comment", "; ".join(scene_comments(scene)))
        root = stage.DefinePrim(ROOT, "Xform")
        stage.SetDefaultPrim(root)
        root.SetCustomDataByKey("instok3d:units", scene.units)
        turn = [value for row in y_up(scene.vertical).tolist() for value in row]
        root.SetCustomDataByKey("instok3d:yUpFromWorld", " ".join(map(str, turn)))
        for name, item, gaussians in y_up_parts(scene):
            prim = stage.DefinePrim(f"{ROOT}/{_prim_name(name)}", "ParticleField3DGaussianSplat")
            _fill(prim, with_degree(gaussians, options.sh_degree), item)
        stage.Save()
        del stage
        if not utilities.CreateNewUsdzPackage(str(layer), str(part)):
            raise OSError(f"OpenUSD could not pack {path}")
        layer.unlink()


def _openusd() -> list[Any]:
    # Not by import statements: pxr has no types that a checker could read.
    try:
        modules = [import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom", "UsdUtils")]
        volumes = import_module("pxr.UsdVol")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "USD needs OpenUSD: pip install 'instok3d[usd]', or write .glb instead"
        ) from error
    if not hasattr(volumes, "ParticleField3DGaussianSplat"):
        raise ModuleNotFoundError(
            "this OpenUSD is older than 26.03 and knows no Gaussians: "
            "pip install --upgrade 'instok3d[usd]'"
        )
    return modules


def _fill(prim: Any, gaussians: Gaussians, item: SceneObject | None) -> None:
    gf, vt = import_module("pxr.Gf"), import_module("pxr.Vt")
    degree = int(gaussians.sh.shape[1] ** 0.5) - 1
    reach = SIGMAS * gaussians.scales.amax(dim=1, keepdim=True)
    quats = gaussians.quats.double().tolist()
    values = {
        "positions": vt.Vec3fArray.FromNumpy(gaussians.means.float().contiguous().numpy()),
        "orientations": vt.QuatfArray([gf.Quatf(*each) for each in quats]),
        "scales": vt.Vec3fArray.FromNumpy(gaussians.scales.float().contiguous().numpy()),
        "opacities": vt.FloatArray.FromNumpy(gaussians.opacities.float().contiguous().numpy()),
        "radiance:sphericalHarmonicsDegree": degree,
        "radiance:sphericalHarmonicsCoefficients": vt.Vec3fArray.FromNumpy(
            gaussians.sh.float().reshape(-1, 3).contiguous().numpy()
        ),
    }
    if len(gaussians.means):
        low = (gaussians.means - reach).amin(dim=0).tolist()
        high = (gaussians.means + reach).amax(dim=0).tolist()
        values["extent"] = vt.Vec3fArray([gf.Vec3f(*low), gf.Vec3f(*high)])
    for name, value in values.items():
        attribute = prim.GetAttribute(name)
        attribute.Set(value)
    if item is not None:
        prim.SetCustomDataByKey("instok3d:id", item.id)
        prim.SetCustomDataByKey("instok3d:key", item.key)
        if item.label:
            prim.SetDisplayName(item.label)


def _prim_name(name: str) -> str:
    """A name as USD allows them: letters, digits and underscores."""
    plain = re.sub("[^A-Za-z0-9_]", "_", name)
    return plain if plain[0].isalpha() else f"object_{plain}"
