"""One ScanNet scan as prepared frames: every tenth frame, cropped to the model's square."""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt16
from PIL import Image

from instok3d.datasets.poses import pose_fault
from instok3d.datasets.prepared import DroppedFrame, PreparedFrame
from instok3d.datasets.scannet.id_maps import IdMaps, Kind, largest_instance
from instok3d.datasets.scannet.sens import SensFile
from instok3d.geometry import checks
from instok3d.photos.cropping import crop_about_principal_point, crop_image, crop_values
from instok3d.photos.pixel_map import PixelMap

ASPECT_TOLERANCE = 0.02
"""1296 x 968 colour and 640 x 480 depth differ by 0.4 %."""


def scan_frames(
    sens: Path,
    *,
    stride: int,
    size: int,
    instances: Path | None = None,
    labels: Path | None = None,
    aggregation: Path | None = None,
) -> Iterator[PreparedFrame | DroppedFrame]:
    """Frames of a .sens scan, as Uni3R and LSM export them.

    Colour is brought to the size of the depth (640 x 480) by nearest and counts as registered
    with it, so that the depth's intrinsics hold for both; then both are cropped.

    Args:
        sens: The scan.
        stride: Raw frames 0, stride, 2 stride, ... are taken.
        size: Height and width.
        instances: Archive of instance maps; None for a scene without ids.
        labels: Archive of label maps; None for a scene without labels.
        aggregation: Says how large the ids of instance maps may be; None does not check them.

    Raises:
        FileNotFoundError: A file is not there.
        ValueError: A file is damaged, or does not belong to the scan.
    """
    with ExitStack() as stack:
        scan = stack.enter_context(SensFile(sens))
        maps = {
            kind: stack.enter_context(_maps_of(scan, path, kind))
            for kind, path in _archives(instances, labels)
        }
        largest = None if aggregation is None else largest_instance(aggregation)
        pixel_map, pixels = _crop(scan, size), math.prod(scan.color_size)
        for number in range(0, len(scan.frames), stride):
            pose = scan.frames[number].world_from_cam
            fault = pose_fault(pose)
            ids = {} if fault else {k: each.read(number, pixels) for k, each in maps.items()}
            missing = [kind for kind, values in ids.items() if values is None]
            if fault or missing:
                reason = fault or f"no {' and no '.join(missing)} map"
                yield DroppedFrame(str(number), reason)
                continue
            cropped = {
                kind: _cropped_ids(values, pixel_map, f"{maps[kind].path}, frame {number}")
                for kind, values in ids.items()
                if values is not None
            }
            _check_instances(cropped.get("instance-filt"), largest, instances, number)
            yield PreparedFrame(
                source=str(number),
                image=crop_image(_at_depth_size(scan, number), pixel_map),
                world_from_cam=pose,
                intrinsics=cropped_intrinsics(scan.intrinsics, pixel_map),
                depth_thousandths=crop_values(scan.depth_mm(number), pixel_map),
                instances=cropped.get("instance-filt"),
                labels=cropped.get("label-filt"),
            )


def check_intrinsics(
    intrinsics: Float[np.ndarray, "3 3"], height: int, width: int, what: str
) -> None:
    """Fail for intrinsics that belong to a picture of another size.

    Raises:
        ValueError: They cannot be intrinsics, or the principal point is far from the middle.
    """
    matrix = torch.from_numpy(np.asarray(intrinsics, np.float64))
    checks.check_intrinsics(matrix, where=what, height=height, width=width, margin=10.0)
    x, y = float(intrinsics[0, 2]), float(intrinsics[1, 2])
    if not (0.3 < x / width < 0.7 and 0.3 < y / height < 0.7):
        raise ValueError(
            f"{what} has its principal point at ({x:g}, {y:g}) in pictures of {width} x {height}: "
            "the intrinsics belong to another resolution; scale them to this one"
        )


def check_same_view(
    found: tuple[int, ...], original_height: int, original_width: int, what: str
) -> None:
    """Fail for a map that cannot show the same view as the picture.

    Raises:
        ValueError: Their aspect ratios differ by more than 2 %.
    """
    ratio = found[1] / found[0] / (original_width / original_height)
    if abs(ratio - 1) > ASPECT_TOLERANCE:
        raise ValueError(
            f"{what} has {found[0]} x {found[1]} pixels, its picture {original_height} x "
            f"{original_width}: not the same view; give the map of this picture"
        )


def cropped_intrinsics(
    intrinsics: Float[np.ndarray, "3 3"], pixel_map: PixelMap
) -> Float[np.ndarray, "3 3"]:
    """Intrinsics of the cropped picture, in float64."""
    return pixel_map.intrinsics_to_model(torch.from_numpy(intrinsics)).numpy()


def _archives(instances: Path | None, labels: Path | None) -> list[tuple[Kind, Path]]:
    both: list[tuple[Kind, Path | None]] = [("instance-filt", instances), ("label-filt", labels)]
    return [(kind, path) for kind, path in both if path is not None]


def _maps_of(scan: SensFile, path: Path, kind: Kind) -> IdMaps:
    maps = IdMaps(path, kind)
    if maps.last_frame >= scan.frame_count:
        raise ValueError(
            f"{path} has a map of frame {maps.last_frame}, but {scan.path} has "
            f"{scan.frame_count} frames: the archive belongs to another scan"
        )
    return maps


def _crop(scan: SensFile, size: int) -> PixelMap:
    height, width = scan.depth_size
    check_same_view(scan.color_size, height, width, f"the colour of {scan.path}")
    check_intrinsics(scan.intrinsics, height, width, str(scan.path))
    return crop_about_principal_point(torch.from_numpy(scan.intrinsics), height, width, size, size)


def _at_depth_size(scan: SensFile, number: int) -> Image.Image:
    height, width = scan.depth_size
    image = scan.image(number)
    if image.size == (width, height):
        return image
    return image.resize((width, height), Image.Resampling.NEAREST)


def _cropped_ids(
    ids: UInt16[np.ndarray, "original_height original_width"], pixel_map: PixelMap, what: str
) -> UInt16[np.ndarray, "height width"]:
    check_same_view(ids.shape, pixel_map.original_height, pixel_map.original_width, what)
    return crop_values(ids, pixel_map)


def _check_instances(
    ids: UInt16[np.ndarray, "height width"] | None,
    largest: int | None,
    archive: Path | None,
    number: int,
) -> None:
    if ids is not None and largest is not None and ids.max(initial=0) > largest:
        raise ValueError(
            f"{archive} has the id {ids.max()} in frame {number}, the scan's aggregation.json "
            f"none above {largest}: the archive belongs to another scan"
        )
