"""Mirrored samples: another room for nothing."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.types import Views


def mirror_sample(sample: Sample) -> Sample:
    """The sample as a mirror shows it: left and right change places, up stays up.

    A point x of a camera is at S x in the mirrored camera, S = diag(-1, 1, 1), and a point of the
    world likewise, so that cameras become S R S, S t: rigid again, and the first one stays the
    world.
    """
    return replace(
        sample,
        context=_mirror_views(sample.context),
        target=_mirror_views(sample.target),
        context_instances=sample.context_instances.flip(-1),
        target_instances=sample.target_instances.flip(-1),
        names=tuple(f"{name} mirrored" for name in sample.names),
    )


def _mirror_views(views: Views) -> Views:
    intrinsics, cam_from_world = views.intrinsics, views.cam_from_world
    return Views(
        images=views.images.flip(-1),
        intrinsics=None if intrinsics is None else _mirror_lens(intrinsics, views.images.shape[-1]),
        cam_from_world=None if cam_from_world is None else _mirror_motion(cam_from_world),
        depths=None if views.depths is None else views.depths.flip(-1),
    )


def _mirror_lens(
    intrinsics: Float[Tensor, "batch view 3 3"], width: int
) -> Float[Tensor, "batch view 3 3"]:
    """The principal point at width - cx, and the skew with the other sign."""
    flipped = intrinsics.clone()
    flipped[..., 0, 1] = -intrinsics[..., 0, 1]
    flipped[..., 0, 2] = width - intrinsics[..., 0, 2]
    return flipped


def _mirror_motion(
    cam_from_world: Float[Tensor, "batch view 4 4"],
) -> Float[Tensor, "batch view 4 4"]:
    signs = torch.tensor([-1.0, 1.0, 1.0, 1.0]).to(cam_from_world)
    return signs[:, None] * cam_from_world * signs
