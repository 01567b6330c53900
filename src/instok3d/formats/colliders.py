"""Simple solids around objects for physics engines: convex hulls and boxes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from instok3d.files import json_text, replacing
from instok3d.formats.glb import GlbBuilder
from instok3d.formats.statements import scene_comments
from instok3d.formats.upright import y_up
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.scene.boxes import OrientedBox
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene

MIN_OPACITY = 0.1
"""Fainter Gaussians are haze around an object and no part of its solid."""
THINNEST = 1e-3
"""Least side of a box in units of its longest: physics engines want solids."""


@dataclass(frozen=True)
class Solid:
    """A closed convex surface of triangles, counter-clockwise seen from outside."""

    vertices: Float[np.ndarray, "vertex 3"]
    """In the scene's world."""
    triangles: Int[np.ndarray, "triangle 3"]


def convex_solid(scene: Scene, item: SceneObject) -> Solid:
    """The convex hull of an object's Gaussians within its oriented box, or that box.

    The box leaves out strays at its sides. It takes the hull's place where the Gaussians lie in a
    plane.
    """
    own = scene.part(item.id)
    points = own.means[own.opacities >= MIN_OPACITY].detach().cpu().double().numpy()
    axes = quat_to_matrix(torch.tensor(item.obb.quat_wxyz).double()).numpy()
    local = (points - np.array(item.obb.center)) @ axes
    points = points[(np.abs(local) <= np.array(item.obb.size) / 2).all(axis=1)]
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # too few points, or all in a plane
        return box_solid(item.obb)
    vertices = points[hull.vertices]
    renumbered = np.full(len(points), -1)
    renumbered[hull.vertices] = np.arange(len(hull.vertices))
    return _outward(Solid(vertices, renumbered[hull.simplices]))


def box_solid(box: OrientedBox) -> Solid:
    """The eight corners and twelve triangles of a box; flat ones get some thickness."""
    size = np.array(box.size)
    size = np.maximum(size, THINNEST * max(size.max(), 1e-6))
    axes = quat_to_matrix(torch.tensor(box.quat_wxyz).double()).numpy()
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    hull = ConvexHull(signs)
    corners = np.array(box.center) + (signs * size / 2) @ axes.T
    return _outward(Solid(corners, hull.simplices.astype(np.int64)))


def write_colliders_glb(
    path: Path, scene: Scene, *, boxes: bool = False, overwrite: bool = False
) -> None:
    """Write the solids of all objects as meshes with y up, one named node for each.

    Args:
        path: A .glb file.
        scene: Whose objects.
        boxes: The oriented boxes instead of convex hulls.
        overwrite: Replace a file that is there.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
    """
    builder, turn = GlbBuilder(), y_up(scene.vertical).double().numpy()
    nodes, meshes = [], []
    for item in scene.objects:
        solid = box_solid(item.obb) if boxes else convex_solid(scene, item)
        position = builder.add((solid.vertices @ turn.T).astype("<f4"), bounds=True)
        indices = builder.add(solid.triangles.reshape(-1).astype("<u4"))
        primitive = {"attributes": {"POSITION": position}, "indices": indices, "mode": 4}
        nodes.append({"name": item.key, "mesh": len(meshes), "extras": {"id": item.id}})
        meshes.append({"name": item.key, "primitives": [primitive]})
    content: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": scene.provenance.generator,
            "extras": {"about": list(scene_comments(scene)), "yUpFromWorld": turn.tolist()},
        },
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))} if nodes else {"name": "empty"}],
    }
    if nodes:
        content |= {"nodes": nodes, "meshes": meshes}
    builder.write(path, content, overwrite=overwrite)


def write_colliders(path: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write hulls as a .glb, or hulls and boxes as JSON, by the ending of the name.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
    """
    if path.suffix.lower() == ".glb":
        write_colliders_glb(path, scene, overwrite=overwrite)
    else:
        write_colliders_json(path, scene, overwrite=overwrite)


def write_boxes_glb(path: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write the oriented boxes of all objects as meshes; see `write_colliders_glb`."""
    write_colliders_glb(path, scene, boxes=True, overwrite=overwrite)


def write_colliders_json(path: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write the hull and the oriented box of each object in the scene's own world.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
    """
    entries = []
    for item in scene.objects:
        solid = convex_solid(scene, item)
        entries.append(
            {
                "id": item.id,
                "key": item.key,
                "label": item.label,
                "box": {
                    "center": item.obb.center,
                    "size": item.obb.size,
                    "quat_wxyz": item.obb.quat_wxyz,
                },
                "hull": {
                    "vertices": solid.vertices.tolist(),
                    "triangles": solid.triangles.tolist(),
                },
            }
        )
    value = {"about": list(scene_comments(scene)), "units": scene.units, "colliders": entries}
    with replacing(path, overwrite=overwrite) as part:
        part.write_text(json_text(value) + "\n", encoding="utf-8")


def _outward(solid: Solid) -> Solid:
    """The same with every triangle counter-clockwise seen from outside."""
    corners = solid.vertices[solid.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(axis=1) - solid.vertices.mean(axis=0)
    inside_out = (normals * outward).sum(axis=1) < 0
    triangles = solid.triangles.astype(np.int64)
    triangles[inside_out] = triangles[inside_out][:, ::-1]
    return Solid(solid.vertices, triangles)
