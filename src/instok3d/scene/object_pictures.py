"""Pictures by which a person knows an object of a scene: alone, and where it is in a photo."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image

from instok3d.geometry.cameras import resize_intrinsics
from instok3d.pictures import color_picture
from instok3d.scene.objects import SceneObject
from instok3d.scene.paths import around
from instok3d.scene.scene import Scene
from instok3d.scene.visibility import BestView
from instok3d.types import Cameras

MARGIN = 0.15
"""Left free on each side of an object, of its own longer side."""
LEAST_SHARE = 0.25
"""Of a view's sides that a picture shows at least: less of a small thing is a blur."""
FADED = 0.75
"""How much white is laid over what of a photo is not the object."""


@dataclass(frozen=True)
class Window:
    """A part of a view, of the view's shape; pixels of the view, not whole ones."""

    left: float
    top: float
    width: float
    height: float


def window_around(best: BestView, height: int, width: int) -> Window:
    """The part of a view about the pixels that an object wins there, within the view.

    Args:
        best: Where they are.
        height: Of the view, pixels.
        width: Likewise.
    """
    x0, y0, x1, y1 = best.bbox
    margin = MARGIN * max(x1 - x0, y1 - y0)
    share = max((x1 - x0 + 2 * margin) / width, (y1 - y0 + 2 * margin) / height, LEAST_SHARE)
    share = min(share, 1.0)
    wide, high = share * width, share * height
    left = min(max((x0 + x1 - wide) / 2, 0.0), width - wide)
    top = min(max((y0 + y1 - high) / 2, 0.0), height - high)
    return Window(left, top, wide, high)


def object_picture(scene: Scene, item: SceneObject) -> UInt8[np.ndarray, "height width 3"]:
    """One object alone on white, enlarged, of the scene's height and width.

    As the input view sees it that shows most of it, or else from around.
    """
    best, size = item.best_view, (scene.height, scene.width)
    if best is None:
        cameras = around(scene.part(item.id), scene.vertical.up, *size, frames=1)
    else:
        cameras = _enlarged(scene.cameras.view(best.view), window_around(best, *size), scene.width)
    picture = scene.render(cameras, *size, only=item.id, background=(1.0, 1.0, 1.0))
    return color_picture(picture.colors[0])


def object_in_photo(scene: Scene, item: SceneObject) -> UInt8[np.ndarray, "height width 3"] | None:
    """The same part of the photo: the pixels that the object wins, outlined in its display colour.

    All else is faded. None where no input view shows the object.
    """
    best = item.best_view
    if best is None:
        return None
    window = window_around(best, scene.height, scene.width)
    box = (window.left, window.top, window.left + window.width, window.top + window.height)
    own = _own_pixels(item, best, scene.height, scene.width)

    def enlarged(picture: np.ndarray, resampling: Image.Resampling) -> np.ndarray:
        size = (scene.width, scene.height)
        return np.asarray(Image.fromarray(picture).resize(size, resampling, box=box))

    photo = enlarged(scene.photos[best.view].cpu().numpy(), Image.Resampling.BICUBIC)
    inside = enlarged(own.astype(np.uint8), Image.Resampling.NEAREST) > 0
    faded = (photo + FADED * (255.0 - photo)).round().astype(np.uint8)
    picture = np.where(inside[..., None], photo, faded)
    wide = np.pad(inside, 1)
    beside = wide[:-2, 1:-1] | wide[2:, 1:-1] | wide[1:-1, :-2] | wide[1:-1, 2:]
    outline = beside & ~inside
    picture[outline] = list(bytes.fromhex(item.color[1:]))
    return picture


def _own_pixels(
    item: SceneObject, best: BestView, height: int, width: int
) -> Bool[np.ndarray, "height width"]:
    """Its mask in its best view; the box where the scene keeps no mask of it."""
    if best.view in item.visible_in and item.sight.masks:
        return item.sight.masks[item.visible_in.index(best.view)].mask().numpy()
    own = np.zeros((height, width), dtype=bool)
    x0, y0, x1, y1 = best.bbox
    own[y0:y1, x0:x1] = True
    return own


def _enlarged(camera: Cameras, window: Window, width: int) -> Cameras:
    """The camera of a picture that shows this part of its view alone, as wide as the view."""
    scale = width / window.width
    intrinsics = resize_intrinsics(
        camera.intrinsics, scale_x=scale, scale_y=scale,
        offset_x=-scale * window.left, offset_y=-scale * window.top,
    )  # fmt: skip
    return Cameras(camera.cam_from_world, intrinsics)
