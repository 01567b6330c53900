"""Figures over scenes from the scores of their views."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from instok3d.evaluation.instance_ap import average_precision, scene_macro_ap
from instok3d.evaluation.scores import GeometryScore, SceneScore, ViewScore, check_numbers


@dataclass(frozen=True)
class Figures:
    """Figures of one method over some scenes; None is what was not measured.

    Pictures: mean over target views. AP: pooled over target views. Cameras: median over scenes of
    the median over a scene's samples. Depth: mean over scenes of the mean over a scene's samples.
    `counts` says over how many scores each figure is where some have no truth.
    """

    scenes: int
    samples: int
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
    id_agreement: float | None
    """Share of pixels whose object id is the same in other views, mean over samples."""
    objects_per_instance: float | None
    """Objects for each true instance that the context views show, over all samples together."""
    whole_share: float | None
    """Of the objects, those with an IoU of at least .5 with an instance."""
    purity: float | None
    """Share of an object's rendered weight that lies in its true instance, mean over objects."""
    purity_by_weight: float | None
    """The same, where each object counts by its rendered weight."""
    found_share: float | None
    """Of the instances, those with which an object has an IoU of at least .5."""
    small_found_share: float | None
    """The same of the instances under 1 % of the pixels of every view."""
    fragment_share: float | None
    """Of the objects, those that are likely pieces of things."""
    listed_whole_share: float | None
    """Of the other objects, those with an IoU of at least .5 with an instance."""
    ap_scannet: float | None
    """AP over the thresholds .50:.05:.90 of ScanNet's benchmark."""
    ap_3d: float | None
    """Of sets of points instead of masks, over .50:.05:.90, pooled over samples."""
    ap50_3d: float | None
    ap25_3d: float | None
    gaussians: float | None
    """Mean over samples; so are the next five."""
    semantic_units: float | None
    label_scalars: float | None
    feature_scalars: float | None
    fit_s: float | None
    """Wall-clock seconds from photos to scene."""
    picture_s: float | None
    """Wall-clock seconds for one target view with its masks."""
    peak_mb: float | None
    """Most memory held while a scene was made, 10^6 bytes; the largest over samples."""
    counts: dict[str, int]
    """Scores behind each figure: target views behind pictures, samples behind cameras, depth and
    groups; behind ap the scenes, and behind ap_scene_mean too, that have an instance; in masks the
    target views whose ids are known; objects and small_instances over all samples."""


PICTURES = ("psnr", "ssim", "lpips", "psnr_depth_scaled")
MEDIANS = ("rotation_deg", "direction_deg", "length_rel")
MEANS = ("depth_rel", "depth_rel_unscaled")
COSTS = ("gaussians", "semantic_units", "label_scalars", "feature_scalars", "fit_s")
ALL_COSTS = (*COSTS, "picture_s", "peak_mb")
SOLID = ("ap_3d", "ap50_3d", "ap25_3d")
OBJECTS = ("objects_per_instance", "whole_share", "purity", "purity_by_weight", "found_share",
           "small_found_share", "fragment_share", "listed_whole_share")  # fmt: skip


def summarize(scenes: Sequence[SceneScore]) -> Figures:
    """Figures over scenes that were measured by one method.

    What has no truth (None) is left out and counted.

    Raises:
        ValueError: A score is not finite.
    """
    views = [view for scene in scenes for view in scene.views]
    samples = [sample for scene in scenes for sample in scene.geometry]
    for scene in scenes:
        for score in (*scene.views, *scene.geometry):
            check_numbers(score, f"scene {scene.name}")
    pooled = average_precision([view.matches for view in views if view.matches])
    macro = scene_macro_ap([[v.matches for v in scene.views if v.matches] for scene in scenes])
    large = average_precision([view.matches_large for view in views if view.matches_large])
    with_masks = sum(view.matches is not None for view in views)
    with_instances = sum(
        any(view.matches and view.matches.num_instances for view in scene.views) for scene in scenes
    )
    pictures = {name: _known(views, name) for name in PICTURES}
    used = [float(count) for scene in scenes for count in scene.groups_used]
    agreements = [share for scene in scenes for share in scene.id_agreement if share is not None]
    objects = [score for scene in scenes for score in scene.objects if score is not None]
    solid = average_precision([each for scene in scenes for each in scene.instances_3d])
    costs = [cost for scene in scenes for cost in scene.costs]
    peaks = [cost.peak_bytes / 1e6 for cost in costs if cost.peak_bytes is not None]
    purities = [purity for score in objects for purity in score.purities]
    weights = [weight for score in objects for weight in score.weights]

    def total(name: str) -> int:
        return sum(getattr(score, name) for score in objects)

    return Figures(
        scenes=len(scenes),
        samples=len(samples),
        targets=len(views),
        **{name: _mean(values) for name, values in pictures.items()},
        ap=_or_none(pooled.ap),
        ap50=_or_none(pooled.ap50),
        ap25=_or_none(pooled.ap25),
        ap_scene_mean=_or_none(macro.ap),
        ap50_scene_mean=_or_none(macro.ap50),
        ap25_scene_mean=_or_none(macro.ap25),
        ap_large=_or_none(large.ap),
        ap50_large=_or_none(large.ap50),
        ap25_large=_or_none(large.ap25),
        instances_per_view=pooled.num_instances / with_masks if with_masks else None,
        masks_per_view=pooled.num_masks / with_masks if with_masks else None,
        **{name: _median(_of_scenes(scenes, name, np.median)) for name in MEDIANS},
        **{name: _mean(_of_scenes(scenes, name, np.mean)) for name in MEANS},
        groups_used=_mean(used),
        id_agreement=_mean(agreements),
        objects_per_instance=_ratio(total("num_objects"), total("num_instances")),
        whole_share=_ratio(total("num_whole"), total("num_objects")),
        purity=_mean(purities),
        purity_by_weight=_weighted_mean(purities, weights),
        found_share=_ratio(total("num_found"), total("num_instances")),
        small_found_share=_ratio(total("num_small_found"), total("num_small")),
        fragment_share=_ratio(total("num_fragments"), total("num_objects")),
        listed_whole_share=_ratio(
            total("num_whole") - total("num_whole_fragments"),
            total("num_objects") - total("num_fragments"),
        ),
        ap_scannet=_or_none(pooled.ap_scannet),
        ap_3d=_or_none(solid.ap_scannet),
        ap50_3d=_or_none(solid.ap50),
        ap25_3d=_or_none(solid.ap25),
        **{name: _mean([float(getattr(cost, name)) for cost in costs]) for name in COSTS},
        picture_s=_mean([seconds for scene in scenes for seconds in scene.picture_s]),
        peak_mb=max(peaks, default=None),
        counts={
            **{name: len(values) for name, values in pictures.items()},
            **{name: len(_known(samples, name)) for name in (*MEDIANS, *MEANS)},
            "ap": with_instances,
            "ap_scene_mean": with_instances,
            "groups_used": len(used),
            "id_agreement": len(agreements),
            "masks": with_masks,
            "objects": total("num_objects"),
            "small_instances": total("num_small"),
        },
    )


def _of_scenes(
    scenes: Sequence[SceneScore], name: str, function: Callable[[list[float]], Any]
) -> list[float]:
    """One value for each scene of which a sample has the score."""
    each = [_known(scene.geometry, name) for scene in scenes]
    return [float(function(values)) for values in each if values]


def _known(scores: Iterable[ViewScore | GeometryScore], name: str) -> list[float]:
    values = (getattr(score, name) for score in scores)
    return [value for value in values if value is not None]


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _weighted_mean(values: Sequence[float], weights: Sequence[float]) -> float | None:
    """None where nothing has weight."""
    return float(np.average(values, weights=weights)) if sum(weights) else None


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _or_none(value: float) -> float | None:
    """NaN is what AP says where there is no instance."""
    return None if np.isnan(value) else value
