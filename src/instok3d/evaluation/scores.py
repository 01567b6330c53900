"""What is measured of each target view and each sample, before it is averaged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.geometry_errors import DepthErrors, camera_errors, depth_errors
from instok3d.evaluation.image_quality import psnr, ssim
from instok3d.evaluation.instance_ap import ApSettings, ImageMatches, PredictedMasks, match_image
from instok3d.objectives.lpips import Lpips
from instok3d.types import Geometry

LARGE_AREA = 50
"""min_instance_area of the second AP that is reported, pixels."""


@dataclass(frozen=True)
class ViewScore:
    """One target view; NaN and None are what was not measured."""

    psnr: float = np.nan
    ssim: float = np.nan
    lpips: float = np.nan
    matches: ImageMatches | None = None
    matches_large: ImageMatches | None = None
    psnr_depth_scaled: float = np.nan


@dataclass(frozen=True)
class GeometryScore:
    """One sample's context views: cameras median over pairs, depth mean over pixels.

    NaN where the truth is not known; without depth the length of a baseline has no scale.
    """

    rotation_deg: float
    direction_deg: float
    length_rel: float
    depth_rel: float
    depth_rel_unscaled: float


@dataclass(frozen=True)
class SceneScore:
    """All samples of one scene, by one method."""

    name: str
    level: str | None
    views: tuple[ViewScore, ...]
    geometry: tuple[GeometryScore, ...] = ()
    groups_used: tuple[int, ...] = ()


@torch.no_grad()
def score_views(
    sample: Sample,
    images: Float[Tensor, "target 3 height width"] | None,
    masks: Sequence[PredictedMasks] | None,
    settings: ApSettings,
    *,
    lpips: Lpips | None = None,
    images_depth_scaled: Float[Tensor, "target 3 height width"] | None = None,
) -> list[ViewScore]:
    """Scores of the target views of a sample of one, for the pictures or masks that are there."""
    photos = sample.target.images[0]
    nothing = torch.full((len(photos),), torch.nan)
    similarity, structure, distance, depth_scaled = nothing, nothing, nothing, nothing
    if images is not None:
        similarity, structure = psnr(images, photos), ssim(images, photos)
        if lpips is not None:
            distance = lpips(images.clamp(0, 1), photos)
    if images_depth_scaled is not None:
        depth_scaled = psnr(images_depth_scaled, photos)
    large = ApSettings(LARGE_AREA, settings.min_predicted_area, settings.void)
    scores = []
    for number, ids in enumerate(sample.target_instances[0].cpu().numpy()):
        found = None if masks is None else match_image(ids, masks[number], settings)
        found_large = None if masks is None else match_image(ids, masks[number], large)
        scores.append(
            ViewScore(
                psnr=float(similarity[number]),
                ssim=float(structure[number]),
                lpips=float(distance[number]),
                matches=found,
                matches_large=found_large,
                psnr_depth_scaled=float(depth_scaled[number]),
            )
        )
    return scores


def score_geometry(sample: Sample, geometry: Geometry) -> GeometryScore:
    """Errors of the predicted cameras and depth of the context views of a sample of one."""
    assert sample.context.depths is not None
    assert sample.context.cam_from_world is not None
    depth = DepthErrors(np.nan, np.nan, np.nan)
    if (sample.context.depths > 0).any():
        depth = depth_errors(geometry.depths[0], sample.context.depths[0])
    cameras = camera_errors(
        geometry.cameras.cam_from_world[0],
        sample.context.cam_from_world[0],
        scale=1.0 if np.isnan(depth.scale) else depth.scale,
    )
    return GeometryScore(
        rotation_deg=float(cameras.rotation_deg.nanmedian()),
        direction_deg=float(cameras.direction_deg.nanmedian()),
        length_rel=np.nan if np.isnan(depth.scale) else float(cameras.length_rel.nanmedian()),
        depth_rel=depth.scaled,
        depth_rel_unscaled=depth.unscaled,
    )
