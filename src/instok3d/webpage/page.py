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
from instok3d.pictures import color_picture
from instok3d.scene.edits.disclosure import edited_words
from instok3d.scene.objects import SceneObject, counted
from instok3d.scene.paths import around
from instok3d.scene.previews import object_picture
from instok3d.scene.scene import Scene
from instok3d.types import Cameras
from instok3d.webpage.packing import PackedGaussians, pack

SCRIPTS = ("gaussians.js", "cameras.js", "picking.js", "drawing.js", "page.js")
SIZE_LIMIT = 6_000_000
"""Bytes that a page should not exceed: view-dependent colours are left out beyond."""
THUMBNAIL = 96
"""Longest side of the picture of an object, pixels."""
AROUND = 6
"""Places around a scene without photos."""
PHOTO_HEIGHT = 128
"""Of the photos at the foot of the page, at most."""


@dataclass(frozen=True)
class PageReport:
    """What became of the scene."""

    bytes: int
    sh_degree: int
    """Of the colours in the page."""
    scene_sh_degree: int


@dataclass(frozen=True)
class Places:
    """Where a person can stand at once: at the photos, or around a scene that has none."""

    cameras: Cameras
    names: tuple[str, ...]
    pictures: UInt8[np.ndarray, "place height width 3"]


def write_page(
    scene: Scene,
    path: Path,
    *,
    name: str | None = None,
    most_coefficients: int = 16,
    overwrite: bool = True,
) -> PageReport:
    """Write a scene as one HTML file, atomically.

    Everything is inside: the Gaussians, the program that draws them (WebGL 2), pictures of the
    objects, the photos. It asks nothing of any server. Objects are listed, selected by a click in
    the picture, hidden and moved; the scene itself stays as it is.

    View-dependent colours of high degree are left out where the file would exceed SIZE_LIMIT.

    Args:
        scene: Hidden objects are left out.
        path: Where to; its folder must exist.
        name: Of the scene, as the page shows it; None takes the file's.
        most_coefficients: Of spherical harmonics: 1, 4, 9 or 16.
        overwrite: Replace a file that is there.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
    """
    scene = scene.drawn()
    present = min(_coefficients(scene), most_coefficients)
    title = name or path.stem
    coefficients, page = present, _page(scene, title, pack(scene.gaussians, present))
    while len(page) > SIZE_LIMIT and coefficients > 1:
        coefficients = (round(coefficients**0.5) - 1) ** 2
        page = _page(scene, title, pack(scene.gaussians, coefficients))
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


def _page(scene: Scene, title: str, packed: PackedGaussians) -> bytes:
    folder = files("instok3d.webpage")

    def source(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    about = json.dumps(_about(scene, title, packed), ensure_ascii=True, allow_nan=False)
    page = Template(source("page.html")).substitute(
        title=_escaped(title),
        style=source("style.css"),
        about=about.replace("<", "\\u003c"),
        gaussians=packed.base64,
        script="\n".join(source(name) for name in SCRIPTS),
    )
    return page.encode()


def _about(scene: Scene, title: str, packed: PackedGaussians) -> dict[str, Any]:
    made, places = scene.provenance, _places(scene)
    return {
        "name": title,
        "layout": [asdict(array) for array in packed.layout],
        "coefficients": packed.coefficients,
        "near_far": list(scene.near_far),
        "up": list(scene.vertical.up),
        "distance": _distance(scene, places.cameras),
        "views": [_view(places, index) for index in range(len(places.names))],
        "objects": [_object(scene, item) for item in scene.objects],
        "lines": [
            f"{counted(scene.objects)}, {len(scene.gaussians.means)} Gaussians",
            f"made by {made.generator} with {made.model}",
            "lengths in metres" if scene.units == "metres" else "lengths in arbitrary units",
            *([edited_words(scene)] if scene.edits else []),
            *scene.warnings,
        ],
    }


def _places(scene: Scene) -> Places:
    if scene.views:
        names = tuple(view.file for view in scene.views)
        return Places(scene.cameras, names, scene.photos.cpu().numpy())
    size = scene.height, scene.width
    cameras = around(scene.gaussians, scene.vertical.up, *size, frames=AROUND)
    pictures = [color_picture(picture) for picture in scene.render(cameras, *size).colors]
    names = tuple(f"around {number}" for number in range(1, AROUND + 1))
    return Places(cameras, names, np.stack(pictures))


def _view(places: Places, index: int) -> dict[str, Any]:
    height, width = places.pictures.shape[1:3]
    world_from_cam = invert_rigid(places.cameras.cam_from_world[index].detach().cpu().double())
    intrinsics = places.cameras.intrinsics[index].detach().cpu().double()
    lens = [intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2] - width / 2, intrinsics[1, 2]]
    return {
        "file": places.names[index],
        "rotation": world_from_cam[:3, :3].T.flatten().tolist(),
        "center": world_from_cam[:3, 3].tolist(),
        "lens": [float(value) / height for value in lens],
        "photo": _jpeg(places.pictures[index], PHOTO_HEIGHT),
    }


def _object(scene: Scene, item: SceneObject) -> dict[str, Any]:
    return {
        "id": item.id,
        "key": item.key,
        "color": item.color,
        "centroid": list(item.centroid),
        "gaussian_range": list(item.gaussian_range),
        "fragment": item.is_fragment,
        "size": size_words(scene, item),
        "picture": thumbnail(scene, item),
    }


def size_words(scene: Scene, item: SceneObject) -> str:
    """The lengths of an object's box, in words."""
    size = " x ".join(f"{length:.2g}" for length in item.obb.size)
    return size + (" m" if scene.units == "metres" else "")


def thumbnail(scene: Scene, item: SceneObject) -> str:
    """A small picture of an object alone as a data address."""
    picture = object_picture(scene, item)
    if item.best_view is not None:
        x0, y0, x1, y1 = item.best_view.bbox
        picture = picture[y0:y1, x0:x1]
    return _jpeg(picture, THUMBNAIL)


def _distance(scene: Scene, cameras: Cameras) -> float:
    """Typical distance of the Gaussians from the first camera, scene units."""
    means = scene.gaussians.means
    if not len(means):
        return 1.0
    center = invert_rigid(cameras.cam_from_world[0])[:3, 3]
    return float(torch.linalg.vector_norm(means - center, dim=1).median())


def _jpeg(picture: UInt8[np.ndarray, "height width 3"], longest: int) -> str:
    """A picture as a data address."""
    image, stream = Image.fromarray(picture), io.BytesIO()
    image.thumbnail((longest, longest))
    image.save(stream, "JPEG", quality=85)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
