"""Photos from disk to `Views`: found, chosen, decoded, fitted, with cameras where they are known.

The way back to the original pixels is kept for every photo.
"""

import os
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.photos.camera_fit import check_distance, check_distortion, fit_camera
from instok3d.photos.cameras import CameraSet, PhotoCamera
from instok3d.photos.captures import find_photos_and_cameras
from instok3d.photos.depth_checks import DepthViews, check_depth
from instok3d.photos.depth_files import depth_at_model_pixels, read_camera_depth
from instok3d.photos.image_decoding import MAX_PIXELS, DecodedPhoto, decode_photo, own_pixel_limit
from instok3d.photos.image_files import find_images as find_images
from instok3d.photos.pixel_map import Fit, PixelMap
from instok3d.photos.view_choice import choose_views, describe_cameras, describe_pictures
from instok3d.types import Views

THUMBNAIL_SIDE = 16
_LOST_SHARE_TO_TELL = 0.4


@dataclass(frozen=True)
class PhotoSet:
    """The photos of one scene as the model takes them, and where they came from."""

    views: Views
    """A batch of one. Cameras and depth are there only if they were given."""
    pixel_maps: tuple[PixelMap, ...]
    """Model pixels to original pixels and back, one for each view."""
    paths: tuple[Path, ...]
    names: tuple[str, ...]
    """The paths below their common folder, with forward slashes; unique."""
    sha256: tuple[str, ...]
    """Of the bytes of each file."""
    units: Literal["metres", "arbitrary"]
    """Of cam_from_world and depths; arbitrary without cameras."""
    intrinsics_source: Literal["cameras", "exif"] | None
    """None when views.intrinsics is None."""
    warnings: tuple[str, ...]
    """What was left out, guessed or ignored; each was also issued through `warnings.warn`."""

    def select(self, kept: Sequence[int]) -> "PhotoSet":
        """Some of the photos, in the order of `kept`."""
        rows = {
            name: tuple(getattr(self, name)[index] for index in kept)
            for name in ("pixel_maps", "paths", "names", "sha256")
        }
        return replace(self, views=self.views.map(lambda value: value[:, list(kept)]), **rows)


def read_photos(
    source: str | Path | Sequence[str | Path],
    *,
    height: int,
    width: int,
    max_views: int | None = 16,
    max_pixels: int = MAX_PIXELS,
    fit: Fit = "crop",
    cameras: str | Path | None = None,
    allow_outside: bool = False,
) -> PhotoSet:
    """`find_photos_and_cameras` and `load_photos` in one call; `warnings` holds those of both.

    Raises:
        FileNotFoundError: Something named is not there.
        PermissionError: Something may not be read.
        ValueError: See the two functions.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        paths, known = find_photos_and_cameras(source, cameras, allow_outside=allow_outside)
        photos = load_photos(
            paths,
            height=height,
            width=width,
            max_views=max_views,
            max_pixels=max_pixels,
            fit=fit,
            cameras=known,
        )
    messages = tuple(str(warning.message) for warning in caught)
    for message in messages:
        warnings.warn(message, stacklevel=2)
    return replace(photos, warnings=messages)


def load_photos(
    paths: Sequence[Path],
    *,
    height: int,
    width: int,
    max_views: int | None = 16,
    max_pixels: int = MAX_PIXELS,
    fit: Fit = "crop",
    cameras: CameraSet | None = None,
) -> PhotoSet:
    """Photos as views of height x width, upright, with cameras and depth where they are given.

    Without cameras the intrinsics come from EXIF if every photo states its 35 mm focal length.
    Same files, same result, whatever the number of threads.

    Args:
        paths: In the order the views shall have; the first one becomes the world.
        height: Of the model's image.
        width: Of the model's image.
        max_views: Of more photos, this many are chosen to cover all (`choose_views`).
        max_pixels: Larger photos are refused from their header.
        fit: crop fills the square that the default model was trained on and loses the border of
            the photo; letterbox keeps everything and adds grey bars.
        cameras: Must have a camera for every photo.

    Raises:
        FileNotFoundError: A photo or its depth file is not there.
        PermissionError: A photo may not be read.
        ValueError: No photo; a photo that is damaged, no picture or too large; a photo without
            camera, or whose shape is not its camera's; depth that does not fit the cameras.
    """
    if not paths:
        raise ValueError("no photo was given")
    paths = [Path(path) for path in paths]
    notes: list[str] = []
    known = None if cameras is None else cameras.of(paths)
    with own_pixel_limit():
        if max_views is not None and len(paths) > max_views:
            keep = _choose(paths, known, max_views, max_pixels)
            notes.append(
                f"{len(paths) - max_views} of {len(paths)} photos were left out: max_views is "
                f"{max_views}, and these were chosen to cover the scene"
            )
            paths = [paths[index] for index in keep]
            known = None if known is None else [known[index] for index in keep]
        photos = _decode_all(paths, height, width, fit, max_pixels)
        notes += [note for photo in photos for note in photo.notes]
        notes += _remarks(photos)
        if known is None:
            intrinsics = _intrinsics_by_exif(photos, notes)
            views = Views(_images(photos), intrinsics)
        else:
            views = _posed_views(photos, paths, known, notes, max_pixels)
            notes += _depth_notes(
                views, known, metric=cameras is not None and cameras.units == "metres"
            )
    for note in notes:
        warnings.warn(note, stacklevel=2)
    return PhotoSet(
        views=views,
        pixel_maps=tuple(photo.pixel_map for photo in photos),
        paths=tuple(paths),
        names=_names(paths),
        sha256=tuple(photo.sha256 for photo in photos),
        units="arbitrary" if cameras is None else cameras.units,
        intrinsics_source=(
            None if views.intrinsics is None else "exif" if cameras is None else "cameras"
        ),
        warnings=tuple(notes),
    )


def _decode_all(
    paths: Sequence[Path], height: int, width: int, fit: Fit, max_pixels: int
) -> list[DecodedPhoto]:
    def decode(path: Path) -> DecodedPhoto:
        return decode_photo(path, height=height, width=width, fit=fit, max_pixels=max_pixels)

    with ThreadPoolExecutor(max_workers=min(os.cpu_count() or 1, 4, len(paths))) as pool:
        waiting = [pool.submit(decode, path) for path in paths]
        try:
            return [future.result() for future in waiting]
        finally:
            pool.shutdown(wait=True, cancel_futures=True)  # after an error decode no more


def _choose(
    paths: Sequence[Path], cameras: list[PhotoCamera] | None, count: int, max_pixels: int
) -> list[int]:
    if cameras is not None:
        descriptors = describe_cameras(torch.stack([c.cam_from_world for c in cameras]))
    else:
        side = THUMBNAIL_SIDE
        thumbnails = _decode_all(paths, side, side, "crop", max_pixels)
        descriptors = describe_pictures(torch.stack([photo.image for photo in thumbnails]))
    return choose_views(descriptors, count)


def _images(photos: Sequence[DecodedPhoto]) -> Float[Tensor, "1 view 3 height width"]:
    return torch.stack([photo.image for photo in photos])[None]


def _remarks(photos: Sequence[DecodedPhoto]) -> list[str]:
    remarks = []
    if len(photos) == 1:
        remarks.append(
            "only one photo: its depth is a guess from one picture and hidden sides stay empty"
        )
    maps = [photo.pixel_map for photo in photos]
    lost = [1 - pixel_map.seen_share for pixel_map in maps]
    if max(lost) > _LOST_SHARE_TO_TELL:
        count = sum(share > _LOST_SHARE_TO_TELL for share in lost)
        remarks.append(
            f"{count} of {len(photos)} photos lose up to {max(lost):.0%} of their area at the "
            "border, which does not fit into the model's image"
        )
    small = [m for m in maps if max(m.scale_x, m.scale_y) > 1.0]
    if small:
        remarks.append(
            f"{len(small)} of {len(photos)} photos have fewer pixels than the model's image of "
            f"{small[0].width} x {small[0].height} and were enlarged"
        )
    return remarks


def _intrinsics_by_exif(
    photos: Sequence[DecodedPhoto], notes: list[str]
) -> Float[Tensor, "1 view 3 3"] | None:
    focals = [photo.focal for photo in photos if photo.focal is not None]
    if len(focals) < len(photos):
        if focals:
            notes.append(
                f"only {len(focals)} of {len(photos)} photos state their focal length; it is "
                "estimated for all"
            )
        return None
    matrices = []
    for focal, photo in zip(focals, photos, strict=True):
        pixel_map = photo.pixel_map
        matrix = torch.diag(torch.tensor([focal, focal, 1.0], dtype=torch.float64))
        matrix[0, 2] = 0.5 * pixel_map.original_width
        matrix[1, 2] = 0.5 * pixel_map.original_height
        matrices.append(pixel_map.intrinsics_to_model(matrix))
    return torch.stack(matrices)[None].float()


def _posed_views(
    photos: Sequence[DecodedPhoto],
    paths: Sequence[Path],
    cameras: Sequence[PhotoCamera],
    notes: list[str],
    max_pixels: int,
) -> Views:
    fitted = [
        fit_camera(camera, photo.pixel_map, path, notes)
        for camera, photo, path in zip(cameras, photos, paths, strict=True)
    ]
    check_distortion(cameras, notes)
    check_distance(cameras)
    depths = None
    if any(camera.depth_path is not None for camera in cameras):
        depths = torch.stack(
            [
                _depth(camera, photo.pixel_map, turned.turned_by, max_pixels)
                for camera, photo, turned in zip(cameras, photos, fitted, strict=True)
            ]
        )[None]
        without = [c.name for c in cameras if c.depth_path is None]
        if without:
            notes.append(
                f"{len(without)} of {len(cameras)} photos have no depth: {', '.join(without)}"
            )
    return Views(
        images=_images(photos),
        intrinsics=torch.stack([camera.intrinsics for camera in fitted])[None].float(),
        cam_from_world=torch.stack([camera.cam_from_world for camera in fitted])[None].float(),
        depths=depths,
    )


def _depth_notes(views: Views, cameras: Sequence[PhotoCamera], *, metric: bool) -> list[str]:
    if views.depths is None or views.intrinsics is None or views.cam_from_world is None:
        return []
    every = DepthViews(
        views.depths[0],
        views.intrinsics[0],
        views.cam_from_world[0],
        tuple(camera.name for camera in cameras),
    )
    given = [index for index, camera in enumerate(cameras) if camera.depth_path is not None]
    return check_depth(every.rows(given), metric=metric)


def _depth(
    camera: PhotoCamera, pixel_map: PixelMap, turned_by: int, max_pixels: int
) -> Float[Tensor, "height width"]:
    if camera.depth_path is None:
        return torch.zeros(pixel_map.height, pixel_map.width)
    depth = read_camera_depth(camera, max_pixels=max_pixels)
    return depth_at_model_pixels(depth, pixel_map, stored_orientation=turned_by)


def _names(paths: Sequence[Path]) -> tuple[str, ...]:
    whole = [Path(os.path.abspath(path)) for path in paths]
    common = Path(os.path.commonpath([path.parent for path in whole]))
    return tuple(path.relative_to(common).as_posix() for path in whole)
