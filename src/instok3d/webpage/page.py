"""Writing a scene as one HTML file."""

import base64
import io
import json
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image

from instok3d.files import replacing
from instok3d.geometry.cameras import invert_rigid
from instok3d.scene.objects import SceneObject
from instok3d.scene.previews import object_picture
from instok3d.scene.scene import Scene
from instok3d.webpage.packing import PackedGaussians, pack

SCRIPTS = ("gaussians.js", "cameras.js", "picking.js", "drawing.js", "page.js")
SIZE_LIMIT = 6_000_000
"""Bytes that a page should not exceed: view-dependent colours are left out beyond."""
THUMBNAIL = 96
"""Longest side of the picture of an object, pixels."""
PHOTO_HEIGHT = 128
"""Of the photos at the foot of the page, at most."""


@dataclass(frozen=True)
class PageReport:
    """What became of the scene."""

    bytes: int
    sh_degree: int
    """Of the colours in the page."""
    scene_sh_degree: int


def write_page(
    scene: Scene, path: Path, *, name: str | None = None, overwrite: bool = True
) -> PageReport:
    """Write a scene as one HTML file, atomically.

    Everything is inside: the Gaussians, the program that draws them (WebGL 2), pictures of the
    objects, the photos. It asks nothing of any server. Objects are listed, selected by a click in
    the picture, hidden and moved; the scene itself stays as it is.

    View-dependent colours of high degree are left out where the file would exceed SIZE_LIMIT.

    Args:
        scene: With at least one view.
        path: Where to; its folder must exist.
        name: Of the scene, as the page shows it; None takes the file's.
        overwrite: Replace a file that is there.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
        ValueError: The scene has no view to begin at.
    """
    if not scene.views:
        raise ValueError("the scene has no views: a page needs a camera to begin at")
    present = _coefficients(scene)
    title = name or path.stem
    for coefficients in (count for count in (16, 9, 4, 1) if count <= present):
        packed = pack(scene.gaussians, coefficients)
        page = _page(scene, title, packed).encode()
        if len(page) <= SIZE_LIMIT:
            break
    with replacing(path, overwrite=overwrite) as part:
        part.write_bytes(page)
    degrees = {1: 0, 4: 1, 9: 2, 16: 3}
    return PageReport(len(page), degrees[coefficients], degrees[present])


def _coefficients(scene: Scene) -> int:
    """How many spherical harmonics a colour of the scene has, without bands that are 0 all over."""
    sh = scene.gaussians.sh
    count = sh.shape[1]
    while count > 1 and not sh[:, (round(count**0.5) - 1) ** 2 : count].any():
        count = (round(count**0.5) - 1) ** 2
    return count


def _page(scene: Scene, title: str, packed: PackedGaussians) -> str:
    folder = files("instok3d.webpage")

    def source(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    about = json.dumps(_about(scene, title, packed), ensure_ascii=True, allow_nan=False)
    return Template(source("page.html")).substitute(
        title=_escaped(title),
        style=source("style.css"),
        about=about.replace("<", "\\u003c"),
        gaussians=packed.base64,
        script="\n".join(source(name) for name in SCRIPTS),
    )


def _about(scene: Scene, title: str, packed: PackedGaussians) -> dict[str, Any]:
    made = scene.provenance
    return {
        "name": title,
        "layout": [asdict(array) for array in packed.layout],
        "coefficients": packed.coefficients,
        "near_far": list(scene.near_far),
        "up": list(scene.vertical.up),
        "distance": _distance(scene),
        "views": [_view(scene, index) for index in range(len(scene.views))],
        "objects": [_object(scene, item) for item in scene.objects],
        "lines": [
            f"{len(scene.objects)} objects, {len(scene.gaussians.means)} Gaussians",
            f"made by {made.generator} with {made.model}",
            "lengths in metres" if scene.units == "metres" else "lengths in arbitrary units",
            *scene.warnings,
        ],
    }


def _view(scene: Scene, index: int) -> dict[str, Any]:
    world_from_cam = invert_rigid(scene.cameras.cam_from_world[index].detach().cpu().double())
    intrinsics = scene.cameras.intrinsics[index].detach().cpu().double()
    height, width = scene.height, scene.width
    lens = [intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2] - width / 2, intrinsics[1, 2]]
    return {
        "file": scene.views[index].file,
        "rotation": world_from_cam[:3, :3].T.flatten().tolist(),
        "center": world_from_cam[:3, 3].tolist(),
        "lens": [float(value) / height for value in lens],
        "photo": _jpeg(scene.photos[index].cpu().numpy(), PHOTO_HEIGHT),
    }


def _object(scene: Scene, item: SceneObject) -> dict[str, Any]:
    x0, y0, x1, y1 = item.best_view.bbox
    picture = object_picture(scene, item)[y0:y1, x0:x1]
    size = " x ".join(f"{length:.2g}" for length in item.obb.size)
    return {
        "id": item.id,
        "key": item.key,
        "color": item.color,
        "centroid": list(item.centroid),
        "gaussian_range": list(item.gaussian_range),
        "size": size + (" m" if scene.units == "metres" else ""),
        "picture": _jpeg(picture, THUMBNAIL),
    }


def _distance(scene: Scene) -> float:
    """Typical distance of the Gaussians from the first camera, scene units."""
    if not len(scene.gaussians.means):
        return 1.0
    center = invert_rigid(scene.cameras.cam_from_world[0])[:3, 3]
    return float(torch.linalg.vector_norm(scene.gaussians.means - center, dim=1).median())


def _jpeg(picture: UInt8[np.ndarray, "height width 3"], longest: int) -> str:
    """A picture as a data address."""
    image, stream = Image.fromarray(picture), io.BytesIO()
    image.thumbnail((longest, longest))
    image.save(stream, "JPEG", quality=85)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
