"""What is measured of each target view and each sample, before it is averaged."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.geometry_errors import camera_errors, depth_errors
from instok3d.evaluation.image_quality import psnr, ssim
from instok3d.evaluation.instance_ap import ApSettings, ImageMatches, PredictedMasks, match_image
from instok3d.evaluation.methods import Cost
from instok3d.evaluation.object_quality import ObjectScore
from instok3d.objectives.lpips import Lpips
from instok3d.types import Geometry

LARGE_AREA = 50
"""min_instance_area of the second AP that is reported, pixels."""


@dataclass(frozen=True)
class ViewScore:
    """One target view; None is what was not measured."""

    psnr: float | None = None
    ssim: float | None = None
    lpips: float | None = None
    matches: ImageMatches | None = None
    matches_large: ImageMatches | None = None
    psnr_depth_scaled: float | None = None


@dataclass(frozen=True)
class GeometryScore:
    """One sample's context views: cameras median over pairs, depth mean over pixels.

    None where there is no truth: depth that nobody measured, and with it the scale of a baseline's
    length; baselines of cameras that stand together; the rotation of one view alone.
    """

    rotation_deg: float | None
    direction_deg: float | None
    length_rel: float | None
    depth_rel: float | None
    depth_rel_unscaled: float | None


@dataclass(frozen=True)
class SceneScore:
    """All samples of one scene, by one method."""

    name: str
    level: str | None
    views: tuple[ViewScore, ...]
    geometry: tuple[GeometryScore, ...] = ()
    groups_used: tuple[int, ...] = ()
    id_agreement: tuple[float | None, ...] = ()
    """Of each sample: see `id_agreement.id_agreement`; None where no two views share a surface."""
    objects: tuple[ObjectScore | None, ...] = ()
    """Of each sample; None where no context view has a known id. Empty where nobody asked."""
    instances_3d: tuple[ImageMatches, ...] = ()
    """Of each sample with known instances and depth: see `instances_3d.match_points`. Empty where
    nobody asked."""
    costs: tuple[Cost, ...] = ()
    """Of the scene of each sample."""
    picture_s: tuple[float, ...] = ()
    """Wall-clock seconds for one target view, of each sample."""


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
    """Scores of the target views of a sample of one, for the pictures or masks that are there.

    A view without any known id (-1 everywhere) has no score of masks.

    Raises:
        ValueError: A picture, and so a score, is not finite.
    """
    photos = sample.target.images[0]
    pictures: dict[str, Float[Tensor, " target"]] = {}
    if images is not None:
        pictures = {"psnr": psnr(images, photos), "ssim": ssim(images, photos)}
        if lpips is not None:
            pictures["lpips"] = lpips(images.clamp(0, 1), photos)
    if images_depth_scaled is not None:
        pictures["psnr_depth_scaled"] = psnr(images_depth_scaled, photos)
    large = ApSettings(LARGE_AREA, settings.min_predicted_area, settings.void)
    scores = []
    for number, ids in enumerate(sample.target_instances[0].cpu().numpy()):
        mask = None if masks is None or (ids == -1).all() else masks[number]
        score = ViewScore(
            matches=None if mask is None else match_image(ids, mask, settings),
            matches_large=None if mask is None else match_image(ids, mask, large),
            **{name: float(values[number]) for name, values in pictures.items()},
        )
        check_numbers(score, f"{sample.names[0]}, target {number},")
        scores.append(score)
    return scores


def score_geometry(sample: Sample, geometry: Geometry) -> GeometryScore:
    """Errors of the predicted cameras and depth of the context views of a sample of one.

    Raises:
        ValueError: What was predicted is not finite.
    """
    assert sample.context.depths is not None
    assert sample.context.cam_from_world is not None
    depth = None
    if (sample.context.depths > 0).any():
        depth = depth_errors(geometry.depths[0], sample.context.depths[0])
    cameras = camera_errors(
        geometry.cameras.cam_from_world[0],
        sample.context.cam_from_world[0],
        scale=1.0 if depth is None else depth.scale,
    )
    score = GeometryScore(
        rotation_deg=_median(cameras.rotation_deg),
        direction_deg=_median(cameras.direction_deg),
        length_rel=None if depth is None else _median(cameras.length_rel),
        depth_rel=None if depth is None else depth.scaled,
        depth_rel_unscaled=None if depth is None else depth.unscaled,
    )
    check_numbers(score, sample.names[0])
    return score


def check_numbers(score: ViewScore | GeometryScore, where: str) -> None:
    """Fail if a score is not finite: a mean that left it out would flatter what was measured.

    Args:
        score: Of one view or one sample.
        where: Of which.

    Raises:
        ValueError: Names the first such score and where it is.
    """
    for name, value in vars(score).items():
        if isinstance(value, float) and not isfinite(value):
            raise ValueError(
                f"{name} of {where} is {value}: look for what is not finite in the model's weights "
                "and in the data of that scene"
            )


def _median(values: Float[Tensor, " pair"]) -> float | None:
    return float(values.median()) if len(values) else None
