"""Binary glTF with KHR_gaussian_splatting: one named node for each object, y up."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from instok3d.formats.glb import GlbBuilder, read_glb
from instok3d.formats.parts import with_degree, y_up_parts
from instok3d.formats.registry import ExportOptions
from instok3d.formats.splats import Splats, drawable_splats
from instok3d.formats.statements import scene_comments, stated_units
from instok3d.formats.upright import FLIP, rigid_turn, y_up
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.reading import naming_damage, whole_number
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians

EXTENSION = "KHR_gaussian_splatting"
RENDERED = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}
BANDS = [(degree, index) for degree in range(4) for index in range(2 * degree + 1)]
POINTS = 0
REMEDY = "export it again"
TRANSFORMS = ("matrix", "translation", "rotation", "scale")


def write_gltf(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians, turned so that y is up; colours of the degree that they have.

    Programs that do not know the extension show points of the right colours.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
    """
    builder, nodes, meshes = GlbBuilder(), [], []
    for name, item, gaussians in y_up_parts(scene):
        if not len(gaussians.means):  # glTF has no empty accessors
            continue
        extras = {} if item is None else {"id": item.id, "label": item.label}
        nodes.append({"name": name, "mesh": len(meshes), "extras": extras})
        primitive = _primitive(builder, with_degree(gaussians, options.sh_degree))
        meshes.append({"name": name, "primitives": [primitive]})
    content: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": scene.provenance.generator,
            "extras": {
                "about": list(scene_comments(scene)),
                "yUpFromWorld": y_up(scene.vertical).tolist(),
            },
        },
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))} if nodes else {"name": "empty"}],
    }
    if nodes:
        content |= {"extensionsUsed": [EXTENSION], "nodes": nodes, "meshes": meshes}
    builder.write(path, content, overwrite=options.overwrite)


def _primitive(builder: GlbBuilder, gaussians: Gaussians) -> dict[str, Any]:
    sh = gaussians.sh.numpy().astype("<f4")
    rgba = torch.cat([0.5 + SH_CONSTANT * gaussians.sh[:, 0], gaussians.opacities[:, None]], dim=1)
    attributes = {
        "POSITION": builder.add(gaussians.means.numpy().astype("<f4"), bounds=True),
        "COLOR_0": builder.add(
            (rgba.clamp(0, 1) * 255).round().to(torch.uint8).numpy(), normalized=True
        ),
        "ROTATION": builder.add(gaussians.quats[:, [1, 2, 3, 0]].numpy().astype("<f4")),
        "SCALE": builder.add(gaussians.scales.numpy().astype("<f4")),
        "OPACITY": builder.add(gaussians.opacities.numpy().astype("<f4")),
    }
    for coefficient, (degree, index) in enumerate(BANDS[: sh.shape[1]]):
        attributes[f"SH_DEGREE_{degree}_COEF_{index}"] = builder.add(sh[:, coefficient])
    names = {name: name if name in ("POSITION", "COLOR_0") else f"{EXTENSION}:{name}"
             for name in attributes}  # fmt: skip
    return {
        "attributes": {names[name]: index for name, index in attributes.items()},
        "mode": POINTS,
        "extensions": {EXTENSION: RENDERED},
    }


def read_gltf(path: Path) -> Splats:
    """The Gaussians of a .glb in OpenCV axes; each named node is a group.

    Its world is turned half around x from glTF's y up. Nodes that our writer named "rest" belong
    to no group.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is damaged, holds no Gaussians, or moves its nodes or packs its numbers,
            which is not read.
    """
    glb = read_glb(path)
    tables, ids, labels = [], [], {}
    with naming_damage(path, REMEDY):
        nodes, meshes = glb.json.get("nodes", []), glb.json.get("meshes", [])
        for node in nodes:
            if "mesh" not in node:
                continue
            if any(key in node for key in TRANSFORMS):
                raise ValueError(f"the node {str(node.get('name'))[:40]!r} is moved by a transform")
            for primitive in meshes[whole_number(node["mesh"])]["primitives"]:
                if EXTENSION in primitive.get("extensions", {}):
                    table = _read_primitive(glb, primitive["attributes"])
                    number = node.get("extras", {}).get("id", 0 if node.get("name") == "rest"
                                                        else len(labels) + 1)  # fmt: skip
                    ids.append(np.full(len(table), whole_number(number, 0, 2**31 - 1), np.int64))
                    tables.append(table)
                    if ids[-1].any() and (name := node.get("extras", {}).get("label")):
                        labels[int(number)] = str(name)
        if not tables and glb.json["scenes"] != [{"name": "empty"}]:
            raise ValueError(f"it has no primitive with {EXTENSION}")
        about = glb.json.get("asset", {}).get("extras", {}).get("about", [])
        units = stated_units([str(line) for line in about])
    width = max((table.shape[1] for table in tables), default=14)
    whole = np.zeros((sum(map(len, tables)), width), np.float32)
    start = 0
    for table in tables:
        whole[start : start + len(table), : table.shape[1]] = table
        start += len(table)
    values = torch.from_numpy(whole)
    splats = drawable_splats(
        path,
        means=values[:, :3],
        quats=values[:, [6, 3, 4, 5]],
        scales=values[:, 7:10],
        opacities=values[:, 10],
        sh=values[:, 11:].unflatten(1, (width // 3 - 3, 3)),
        object_ids=torch.from_numpy(np.concatenate([np.zeros(0, np.int64), *ids])),
        up=(0.0, 1.0, 0.0),
        units=units,
    )
    return replace(splats, labels=labels).moved(rigid_turn(FLIP))


def _read_primitive(glb: Any, attributes: dict[str, int]) -> np.ndarray:
    """Columns: position, rotation xyzw, scale, opacity, coefficients of colour."""
    names = ["POSITION", *(f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))]
    harmonics = [f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{index}" for degree, index in BANDS]
    present = [name for name in harmonics if name in attributes]
    if present not in [harmonics[:count] for count in (1, 4, 9, 16)]:
        raise ValueError("a primitive lacks coefficients of its colours")
    columns = [glb.floats(attributes[name]) for name in (*names, *present)]
    widths = [column.shape[1] for column in columns]
    if widths != [3, 4, 3, 1] + [3] * len(present) or len({len(c) for c in columns}) != 1:
        raise ValueError("attributes of a primitive do not fit each other")
    return np.concatenate(columns, axis=1)
