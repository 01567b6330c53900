"""Where the id maps of the context views come from that methods are given."""

from collections.abc import Callable
from typing import Literal
from zlib import crc32

from jaxtyping import Float, Int
from torch import Tensor

from instok3d.baselines.degraded_masks import degraded_masks
from instok3d.baselines.flow_tracking import require_opencv, tracked_by_flow
from instok3d.baselines.tracking import tracked, unmatched
from instok3d.data.sample import Sample, photos_only
from instok3d.types import Cameras, Geometry, Views

MaskSource = Literal["true", "degraded", "segmenter"]
"""true: of the data. degraded: these, with the faults of a segmentation network in each view.
segmenter: those that such a network finds in each photo alone."""
Tracker = Literal["true-ids", "true-depth", "predicted-depth", "flow2d", "none"]
"""How ids come to hold across views. true-ids: those of the data. true-depth, predicted-depth: by
depth and cameras, true or of a geometry network. flow2d: by optical flow. none: not at all."""

Segment = Callable[[Float[Tensor, "view 3 height width"]], Int[Tensor, "view height width"]]
"""The masks of each photo alone, ids in each anew; 0 = none."""
GeometryOf = Callable[[Views], Geometry]
"""The backbone of a model."""
MasksOf = Callable[[Sample], Int[Tensor, "view height width"]]


RULE: dict[MaskSource, Tracker] = {
    "true": "true-ids",
    "degraded": "true-depth",
    "segmenter": "predicted-depth",
}
"""The tracker of masks where none is named."""


def tracker_for(source: MaskSource, asked: Tracker | None) -> Tracker:
    """The tracker of a row of a table: the one that was asked for; true masks keep their ids."""
    return RULE[source] if asked is None or source == "true" else asked


def check_masks(source: MaskSource, tracker: Tracker) -> None:
    """Refuse what has no meaning.

    Raises:
        ValueError: Masks of single photos have no true ids.
    """
    if source != "true" and tracker == "true-ids":
        raise ValueError(
            f"--masks {source} have no ids that hold across views: choose --tracker true-depth, "
            "predicted-depth, flow2d or none"
        )


def context_masks(
    source: MaskSource,
    tracker: Tracker,
    *,
    geometry_of: GeometryOf | None = None,
    segment: Segment | None = None,
    seed: int = 0,
) -> MasksOf:
    """What gives the id maps of the context views of a sample of one.

    Args:
        source: Of the masks.
        tracker: How ids come to hold across views.
        geometry_of: A geometry network, which predicted-depth shows the bare photos.
        segment: Finds the masks of the source segmenter.
        seed: Of the faults, which also depend on the name of the sample.

    Raises:
        ValueError: See `check_masks`; or predicted-depth or segmenter without its network.
        ModuleNotFoundError: flow2d without OpenCV.
    """
    check_masks(source, tracker)
    if tracker == "predicted-depth" and geometry_of is None:
        raise ValueError("tracker predicted-depth needs a geometry network, got None")
    if source == "segmenter" and segment is None:
        raise ValueError("masks of a segmenter need the segmenter, got None")
    if tracker == "flow2d":
        require_opencv()

    def masks_of(sample: Sample) -> Int[Tensor, "view height width"]:
        masks = sample.context_instances[0]
        if source == "segmenter":
            assert segment is not None
            masks = segment(sample.context.images[0])
        if source == "degraded":
            masks = degraded_masks(masks, seed=(seed, crc32(sample.names[0].encode())))
        if tracker == "true-ids":
            return masks
        if tracker == "none":
            return unmatched(masks)
        context = sample.context
        if tracker == "flow2d":
            return tracked_by_flow(masks, context.images[0])
        if tracker == "predicted-depth":
            assert geometry_of is not None
            geometry = geometry_of(photos_only(context))
            return tracked(masks, geometry.depths[0], geometry.cameras.scene(0))
        if context.depths is None or context.cam_from_world is None or context.intrinsics is None:
            raise ValueError(f"{sample.names[0]} has no true depth to track masks by")
        cameras = Cameras(context.cam_from_world[0], context.intrinsics[0])
        return tracked(masks, context.depths[0], cameras)

    return masks_of
