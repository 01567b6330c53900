"""Figures over scenes from the scores of their views."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from instok3d.evaluation.instance_ap import average_precision, scene_macro_ap
from instok3d.evaluation.scores import SceneScore


@dataclass(frozen=True)
class Figures:
    """Figures of one method over some scenes; None is what was not measured.

    Pictures: mean over target views. AP: pooled over target views. Cameras: median over scenes of
    the median over a scene's samples. Depth: mean over scenes of the mean over a scene's samples.
    """

    scenes: int
    targets: int
    psnr: float | None
    ssim: float | None
    lpips: float | None
    ap: float | None
    ap50: float | None
    ap25: float | None
    ap_scene_mean: float | None
    ap50_scene_mean: float | None
    ap25_scene_mean: float | None
    ap_large: float | None
    """Over instances of at least LARGE_AREA pixels; so are the next two."""
    ap50_large: float | None
    ap25_large: float | None
    instances_per_view: float | None
    """Instances that are asked for."""
    masks_per_view: float | None
    rotation_deg: float | None
    direction_deg: float | None
    """Of the baseline between two context views."""
    length_rel: float | None
    """Relative error of the baseline's length, in the scale that fits the depth."""
    depth_rel: float | None
    """After one scale for each sample."""
    depth_rel_unscaled: float | None
    psnr_depth_scaled: float | None
    """PSNR where the length of the predicted world comes from true depth, not from baselines."""
    groups_used: float | None
    """Groups that win at least one anchor, mean over samples."""


def summarize(scenes: Sequence[SceneScore]) -> Figures:
    """Figures over scenes that were measured by one method; what has no truth is left out."""
    views = [view for scene in scenes for view in scene.views]
    pooled = average_precision([view.matches for view in views if view.matches])
    macro = scene_macro_ap([[v.matches for v in scene.views if v.matches] for scene in scenes])
    large = average_precision([view.matches_large for view in views if view.matches_large])
    with_masks = sum(view.matches is not None for view in views)

    def of_scenes(name: str, of_samples: str) -> list[float]:
        function = {"median": np.median, "mean": np.mean}[of_samples]
        each = [_not_nan(getattr(score, name) for score in scene.geometry) for scene in scenes]
        return [float(function(values)) for values in each if values]

    return Figures(
        scenes=len(scenes),
        targets=len(views),
        psnr=_mean(view.psnr for view in views),
        ssim=_mean(view.ssim for view in views),
        lpips=_mean(view.lpips for view in views),
        ap=_known(pooled.ap),
        ap50=_known(pooled.ap50),
        ap25=_known(pooled.ap25),
        ap_scene_mean=_known(macro.ap),
        ap50_scene_mean=_known(macro.ap50),
        ap25_scene_mean=_known(macro.ap25),
        ap_large=_known(large.ap),
        ap50_large=_known(large.ap50),
        ap25_large=_known(large.ap25),
        instances_per_view=pooled.num_instances / with_masks if with_masks else None,
        masks_per_view=pooled.num_masks / with_masks if with_masks else None,
        rotation_deg=_median(of_scenes("rotation_deg", "median")),
        direction_deg=_median(of_scenes("direction_deg", "median")),
        length_rel=_median(of_scenes("length_rel", "median")),
        depth_rel=_mean(of_scenes("depth_rel", "mean")),
        depth_rel_unscaled=_mean(of_scenes("depth_rel_unscaled", "mean")),
        psnr_depth_scaled=_mean(view.psnr_depth_scaled for view in views),
        groups_used=_mean(float(count) for scene in scenes for count in scene.groups_used),
    )


def _mean(values: Iterable[float]) -> float | None:
    known = _not_nan(values)
    return float(np.mean(known)) if known else None


def _median(values: Iterable[float]) -> float | None:
    known = _not_nan(values)
    return float(np.median(known)) if known else None


def _not_nan(values: Iterable[float]) -> list[float]:
    return [value for value in values if not np.isnan(value)]


def _known(value: float) -> float | None:
    return None if np.isnan(value) else value
