"""Masks brought to ids that hold across views by optical flow between the photos alone.

It stands where DEVA stands beside SAM: neither depth nor cameras are known, and each view's masks
are carried into its neighbours in the order of the views. Needs OpenCV
(`pip install 'instok3d[flow]'`).
"""

from types import ModuleType

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from instok3d.baselines.tracking import Link, joined, overlaps, unmatched

REACH = 2
"""Views before and after, in the order that they are shown, into which masks are carried."""
RETURN_PX = 2.0
"""A pixel that flow to another view and back leaves farther from where it was shows nothing."""
MIN_SIDE_PX = 12
"""Of a picture for which OpenCV finds flow."""
GREY = (0.299, 0.587, 0.114)
"""Of red, green and blue, as in Rec. 601."""


def tracked_by_flow(
    masks: Int[Tensor, "view height width"], photos: Float[Tensor, "view 3 height width"]
) -> Int[Tensor, "view height width"]:
    """The masks with ids that hold across views.

    Two masks may be one thing where their IoU is at least `tracking.MIN_IOU` over the pixels that
    flow moves from one view to the other and back again; the best pairs are joined first, as long
    as no thing gets two masks in one view (`tracking.joined`).

    Args:
        masks: Ids of each view for itself; below 1 is no mask.
        photos: In the order in which they were taken, sRGB in [0, 1].

    Returns:
        Ids 1, 2, ...; 0 = no mask.

    Raises:
        ModuleNotFoundError: OpenCV is not installed.
        ValueError: The photos are too small for flow.
    """
    if max(photos.shape[-2:]) < MIN_SIDE_PX:
        height, width = photos.shape[-2:]
        raise ValueError(
            f"tracking by flow needs photos of a side of at least {MIN_SIDE_PX} pixels, got "
            f"{height} x {width}: choose another tracker"
        )
    own = unmatched(masks)
    pictures = [_grey(photo) for photo in photos]
    links: list[Link] = []
    for first in range(len(own)):
        for second in range(first + 1, min(first + REACH + 1, len(own))):
            there = flow_between(pictures[first], pictures[second])
            back = flow_between(pictures[second], pictures[first])
            links += carried(own[first], own[second], there, back)
            links += carried(own[second], own[first], back, there)
    return joined(own, links)


def flow_between(
    first: UInt8[np.ndarray, "height width"], second: UInt8[np.ndarray, "height width"]
) -> Float[np.ndarray, "height width 2"]:
    """Where each pixel of the first picture is in the second: x and y of the shift, pixels.

    Dense inverse search (Kroeger et al., ECCV 2016).

    Args:
        first: Grey, 0 to 255.
        second: Of the same size.

    Raises:
        ModuleNotFoundError: OpenCV is not installed.
    """
    opencv = require_opencv()
    search = opencv.DISOpticalFlow_create(opencv.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return search.calc(first, second, None)


def carried(
    here: Int[Tensor, "height width"],
    there: Int[Tensor, "height width"],
    flow: Float[np.ndarray, "height width 2"],
    back: Float[np.ndarray, "height width 2"],
) -> list[Link]:
    """Pairs of masks that overlap enough once those of one view are carried into the other.

    Args:
        here: Numbers of the masks of one view; below 1 is none.
        there: Of another view.
        flow: From the first view to the other, x and y, pixels.
        back: From the other view to the first.
    """
    rows, columns, known = _targets(flow)
    off = flow + back[rows, columns]
    kept = torch.from_numpy(known & (np.hypot(off[..., 0], off[..., 1]) <= RETURN_PX))
    moved = there[torch.from_numpy(rows), torch.from_numpy(columns)]
    return overlaps(here[kept], moved[kept])


def _targets(
    flow: Float[np.ndarray, "height width 2"],
) -> tuple[
    Int[np.ndarray, "height width"],
    Int[np.ndarray, "height width"],
    Bool[np.ndarray, "height width"],
]:
    """Row and column of the pixel into which each falls, and whether it is in the picture."""
    height, width = flow.shape[:2]
    rows, columns = np.mgrid[:height, :width]
    columns = np.rint(columns + flow[..., 0]).astype(np.int64)
    rows = np.rint(rows + flow[..., 1]).astype(np.int64)
    known = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    return rows.clip(0, height - 1), columns.clip(0, width - 1), known


def _grey(photo: Float[Tensor, "3 height width"]) -> UInt8[np.ndarray, "height width"]:
    grey = (photo * photo.new_tensor(GREY)[:, None, None]).sum(dim=0)
    return (grey * 255).round().clamp(0, 255).to(torch.uint8).cpu().numpy()


def require_opencv() -> ModuleType:
    """OpenCV.

    Raises:
        ModuleNotFoundError: It is not there; says how to install it.
    """
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "tracking by flow needs OpenCV: pip install 'instok3d[flow]'"
        ) from error
    return cv2
