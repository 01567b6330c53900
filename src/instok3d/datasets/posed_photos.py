"""One photo with its camera as a frame of a prepared scene: cropped, undistorted, ids and depth."""

import hashlib
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8, UInt16
from PIL import Image
from torch import Tensor

from instok3d.datasets.prepared import PreparedFrame
from instok3d.datasets.scannet.id_maps import read_id_png
from instok3d.geometry.cameras import invert_rigid
from instok3d.photos.camera_fit import fit_camera
from instok3d.photos.cameras import PhotoCamera
from instok3d.photos.cropping import crop_about_principal_point, crop_values
from instok3d.photos.depth_files import depth_at_model_pixels, read_camera_depth
from instok3d.photos.distortion import Distortion
from instok3d.photos.image_decoding import DecodedPhoto, decode_photo
from instok3d.photos.pixel_map import PixelMap
from instok3d.photos.undistortion import Undistortion, undistortion

_SUPERSAMPLING = 2  # of pictures that are undistorted, or interpolation would blur them


@dataclass(frozen=True)
class PhotoFiles:
    """What belongs to one frame on the disk."""

    photo: Path
    source: str
    """Its name in the prepared scene."""
    camera: PhotoCamera | None = None
    """None for a photo without."""
    ids: Path | UInt16[np.ndarray, "height width"] | None = None
    """Map of instance ids, of the photo's size: a file of 8 or 16 bits, whose photo EXIF does not
    turn, or the numbers for the upright photo."""
    with_depth: bool = False
    """Whether the scene has depth; a photo without then gets zeros."""


def origin_of(photos: Iterable[Path], *others: bytes) -> str:
    """What a scene is made of, to tell it from another of its name.

    Args:
        photos: Their names and sizes count; none is read.
        others: What else goes in, such as cameras.
    """
    sizes = [(photo.name, photo.stat().st_size) for photo in photos]
    digest = hashlib.sha256(repr(sizes).encode())
    for data in others:
        digest.update(hashlib.sha256(data).digest())
    return f"{len(sizes)} files, {digest.hexdigest()[:12]}"


def prepared_photo(files: PhotoFiles, size: int) -> PreparedFrame:
    """A square frame of a photo.

    With a camera it is cropped about the principal point and freed of lens distortion, without
    about the middle. Cameras made for the photo at another resolution are scaled; EXIF rotation
    is followed by the camera, too.

    Raises:
        FileNotFoundError: A file is not there.
        ValueError: A file is damaged; camera, ids or depth do not fit the photo; ids of a photo
            that is turned by EXIF; a lens that is not nearly a pinhole.
    """
    if files.camera is None:
        decoded = decode_photo(files.photo, height=size, width=size)
        _tell(decoded)
        ids = None if files.ids is None else crop_values(_ids(files, decoded), decoded.pixel_map)
        return PreparedFrame(files.source, _bytes(decoded), None, None, instances=ids)
    bent = bool(files.camera.distortion)
    fine = _SUPERSAMPLING * size if bent else size
    decoded = decode_photo(
        files.photo, height=fine, width=fine, fit=partial(_crop, files.camera, files.photo, fine)
    )
    notes: list[str] = []
    fitted = fit_camera(files.camera, decoded.pixel_map, files.photo, notes)
    _tell(decoded, notes)
    layers = {
        "depth_thousandths": _depth(files, decoded.pixel_map, fitted.turned_by),
        "instances": None if files.ids is None
        else crop_values(_ids(files, decoded), decoded.pixel_map),
    }  # fmt: skip
    image, intrinsics = _bytes(decoded), fitted.intrinsics
    if bent:
        distortion = _turned(files.camera, fitted.turned_by, files.photo)
        lens = undistortion(fitted.intrinsics, distortion, fine, fine)
        image, intrinsics, layers = _straight(lens, image, layers)
    return PreparedFrame(
        source=files.source,
        image=image,
        world_from_cam=invert_rigid(fitted.cam_from_world).numpy(),
        intrinsics=intrinsics.numpy(),
        **layers,
    )


def _crop(camera: PhotoCamera, photo: Path, size: int, whole: PixelMap) -> PixelMap:
    intrinsics = fit_camera(camera, whole, photo, []).intrinsics
    cropped = crop_about_principal_point(intrinsics, whole.height, whole.width, size, size)
    return replace(cropped, exif_orientation=whole.exif_orientation)


def _straight(
    lens: Undistortion,
    image: UInt8[np.ndarray, "fine_height fine_width 3"],
    layers: dict[str, UInt16[np.ndarray, "fine_height fine_width"] | None],
) -> tuple[
    UInt8[np.ndarray, "height width 3"],
    Float[Tensor, "3 3"],
    dict[str, UInt16[np.ndarray, "height width"] | None],
]:
    coarse = lens.reduced(_SUPERSAMPLING)
    small = Image.fromarray(lens.colors(image)).reduce(_SUPERSAMPLING)
    return (
        np.asarray(small),
        coarse.intrinsics,
        {key: None if v is None else coarse.values(v) for key, v in layers.items()},
    )


def _bytes(decoded: DecodedPhoto) -> UInt8[np.ndarray, "height width 3"]:
    return (decoded.image.permute(1, 2, 0) * 255).round().byte().numpy()


def _tell(decoded: DecodedPhoto, notes: list[str] | None = None) -> None:
    for note in (*decoded.notes, *(notes or ())):
        warnings.warn(note, stacklevel=4)


def _turned(camera: PhotoCamera, turned_by: int, photo: Path) -> Distortion:
    if turned_by != 1 and camera.distortion.is_tangential:
        raise ValueError(
            f"{photo} is turned by EXIF and its lens has tangential distortion; undistort the "
            "photos first (colmap image_undistorter)"
        )
    return camera.distortion


def _ids(files: PhotoFiles, decoded: DecodedPhoto) -> UInt16[np.ndarray, "height width"]:
    assert files.ids is not None
    pixel_map = decoded.pixel_map
    if isinstance(files.ids, Path):
        pixels = pixel_map.original_height * pixel_map.original_width
        ids, name = read_id_png(files.ids.read_bytes(), str(files.ids), pixels), str(files.ids)
        if pixel_map.exif_orientation != 1:
            raise ValueError(
                f"{files.photo} is turned by EXIF, so how its ids {files.ids.name} lie is not "
                "known; save the photo upright and make its ids again"
            )
    else:
        ids, name = files.ids, f"of {files.photo}"
    if ids.shape != (pixel_map.original_height, pixel_map.original_width):
        raise ValueError(
            f"the id map {name} has {ids.shape[1]} x {ids.shape[0]} pixels, its photo "
            f"{pixel_map.original_width} x {pixel_map.original_height}; they must be equal"
        )
    return ids


def _depth(
    files: PhotoFiles, pixel_map: PixelMap, turned_by: int
) -> UInt16[np.ndarray, "height width"] | None:
    if not files.with_depth:
        return None
    camera = files.camera
    if camera is None or camera.depth_path is None:
        return np.zeros((pixel_map.height, pixel_map.width), dtype=np.uint16)
    depth = read_camera_depth(camera)
    thousandths = depth_at_model_pixels(depth, pixel_map, stored_orientation=turned_by) * 1000
    known = thousandths.round() <= np.iinfo(np.uint16).max
    return torch.where(known, thousandths, 0).round().numpy().astype(np.uint16)
