"""Cameras and depth that a model takes as if they were given, in the lengths that it knows."""

from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from instok3d.types import Cameras, Views

TYPICAL_DEPTH = 2.5
"""Median depth of a room in metres, to which a scene of arbitrary units is scaled: models that
take lengths as they are were trained on rooms in metres."""
UNSURE = 0.25
"""Depth is unsure below this share of the median confidence. Networks learn a confidence that is
inverse to the expected error, so such depth is expected to be four times as wrong as usual."""


@dataclass(frozen=True)
class SuppliedGeometry:
    """Photos of the model's size with the cameras and depth of a source."""

    views: Views
    """A batch of one. Depth is 0 where it is unsure."""
    unsure: Bool[Tensor, "view height width"]


def find_unsure(
    depths: Float[Tensor, "1 view height width"],
    confidences: Float[Tensor, "1 view height width"],
    cameras: Cameras,
    *,
    name: str,
) -> Bool[Tensor, "1 view height width"]:
    """Where depth is to count as unknown.

    Args:
        depths: As a source gives them.
        confidences: Likewise.
        cameras: Likewise.
        name: Of the source, for the message.

    Raises:
        ValueError: The cameras are not finite, or no depth is.
    """
    sound = depths.isfinite() & (depths > 0) & confidences.isfinite()
    if not (sound.any() and cameras.cam_from_world.isfinite().all()
            and cameras.intrinsics.isfinite().all()):  # fmt: skip
        raise ValueError(
            f"{name} finds no geometry in these photos: its answer is not finite; take "
            "--geometry nano"
        )
    return ~sound | (confidences < UNSURE * confidences[sound].median())


def in_typical_lengths(views: Views) -> Views:
    """Views with cameras and depth, lengths multiplied so that the median depth is TYPICAL_DEPTH.

    Unknown depth, which is 0, does not count.
    """
    assert views.cam_from_world is not None
    assert views.depths is not None
    scale = TYPICAL_DEPTH / views.depths[views.depths > 0].median()
    cam_from_world = views.cam_from_world.float().clone()
    cam_from_world[..., :3, 3] *= scale
    return replace(views, cam_from_world=cam_from_world, depths=views.depths * scale)


def unsure_patches(
    unsure: Bool[Tensor, "view height width"], patch_size: int
) -> Bool[Tensor, " patch"]:
    """Patches that are unsure in more than half of their pixels, view by view, row-major."""
    return (functional.avg_pool2d(unsure[:, None].float(), patch_size) > 0.5).flatten()
