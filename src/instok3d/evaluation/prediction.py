"""What a model makes of one sample: pictures and masks at the target cameras, and its geometry."""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from time import perf_counter

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.camera_refinement import refined_cameras
from instok3d.evaluation.instance_ap import ImageMatches, PredictedMasks
from instok3d.evaluation.instances_3d import match_points
from instok3d.evaluation.methods import FAR, NEAR, Cost, FittedScene, Method, Seen, show
from instok3d.evaluation.object_quality import FoundObjects, found_objects
from instok3d.evaluation.peak_memory import Peak, peak_memory
from instok3d.evaluation.tokenizer_method import GeometryMode, Model, TokenizerMethod
from instok3d.geometry.camera_alignment import (
    TargetCameras,
    baseline_scale,
    cameras_in_prediction,
)
from instok3d.geometry.similarity import depth_scale
from instok3d.render import render
from instok3d.types import Cameras, Geometry, Views


@dataclass(frozen=True)
class RenderedIds:
    """The groups that views of one scene show, and how far away what they show is."""

    ids: Int[Tensor, "view height width"]
    """-1 for no group."""
    depths: Float[Tensor, "view height width"]
    """z-depth in units of the predicted world; 0 where nothing is."""
    cameras: Cameras
    """In the predicted world."""


@dataclass(frozen=True)
class Prediction:
    """One scene, seen from the target cameras."""

    images: Float[Tensor, "target 3 height width"]
    masks: tuple[PredictedMasks, ...] | None
    """For each target view; None of a method that knows no instances."""
    num_groups_used: int | None
    """Groups that win at least one anchor (against each other and the void); None without any."""
    cameras: Cameras
    """The target cameras in the predicted world, as they were rendered."""
    geometry: Geometry | None
    """Of the context views, batch of one; None of a method that does not predict it."""
    cost: Cost
    """Of the scene."""
    picture_s: float
    """Wall-clock seconds that one target view took, with its masks."""
    images_depth_scaled: Float[Tensor, "target 3 height width"] | None
    """The targets rendered with the length fitted to true depth instead of baselines: a
    diagnostic that says how much of an error is the length alone. None at true target cameras and
    where no depth is known."""
    instances_3d: ImageMatches | None = None
    """Groups against true instances in space; if asked for."""
    rendered_ids: RenderedIds | None = None
    """Of the context views at their predicted cameras, then of the targets; if asked for."""
    objects: FoundObjects | None = None
    """Of the context views at their predicted cameras; if asked for."""
    aligned: "Prediction | None" = None
    """The same scene with each target camera fitted to its photo; if asked for."""


def predict(
    model: Model,
    sample: Sample,
    mode: GeometryMode,
    *,
    target_cameras: TargetCameras = "aligned",
    refine: int = 0,
    with_ids: bool = False,
) -> Prediction:
    """`predict_by` the tokenizer; with given cameras targets are rendered at the true ones."""
    where = "true" if mode == "given" else target_cameras
    method = TokenizerMethod(model, mode, refine)
    return predict_by(method, sample, target_cameras=where, with_ids=with_ids)


@torch.no_grad()
def predict_by(
    method: Method,
    sample: Sample,
    *,
    masks: Int[Tensor, "view height width"] | None = None,
    target_cameras: TargetCameras,
    pose_alignment_steps: int = 0,
    with_ids: bool = False,
    with_objects: bool = False,
    with_instances_3d: bool = False,
    with_peak: bool = False,
    also_aligned: int = 0,
) -> Prediction:
    """Fit a method to the context views of a sample and render its scene at the targets.

    Args:
        method: Shown what it needs and no more.
        sample: A batch of one.
        masks: Id maps of the context views, for a method that needs them.
        target_cameras: Where the targets are rendered.
        pose_alignment_steps: See `camera_refinement.refined_cameras`; 0 leaves it out.
        with_ids: Also render the ids of the context views, for `rendered_ids`.
        with_objects: Also find the objects of the scene in the context views, for `objects`.
        with_instances_3d: Also match groups to true instances in space.
        with_peak: Also measure the memory that the fit takes, for `Cost.peak_bytes`.
        also_aligned: Steps of `camera_refinement.refined_cameras` for `aligned`; 0 leaves it out.

    Raises:
        ValueError: The sample is no batch of one, or lacks true cameras or depth; or the method
            cannot make a scene of it.
    """
    batch, _, _, height, width = sample.target.images.shape
    if batch != 1:
        raise ValueError(f"predict needs a sample of one scene, got {batch}")
    if sample.context.depths is None:
        raise ValueError("context.depths is missing; an evaluation sample carries true depth")
    shown = show(sample, method.needs, masks)
    measured = peak_memory(shown.views.images.device) if with_peak else nullcontext(Peak())
    try:
        with measured as peak:
            scene = method.fit(shown)
    except ValueError as error:
        raise ValueError(f"{sample.names[0]} cannot be measured: {error}") from error
    cameras, by_depth = _placed(scene, sample, target_cameras)
    contexts = scene.at(scene.cameras, height, width) if with_ids else None
    objects = None
    if with_objects and scene.assignment is not None:
        objects = found_objects(
            scene.gaussians, scene.assignment, scene.cameras, height, width, near=NEAR, far=FAR
        )
    solid = match_points(scene, sample, target_cameras) if with_instances_3d else None

    def fitted(steps: int) -> Prediction:
        at = refined_cameras(scene.gaussians, cameras, sample.target.images[0], steps=steps)
        started = perf_counter()
        seen = scene.at(at, height, width)
        seconds = perf_counter() - started
        return Prediction(
            images=seen.rendering.colors,
            masks=seen.masks,
            num_groups_used=scene.num_groups_used(),
            cameras=at,
            geometry=scene.geometry,
            cost=replace(scene.cost, peak_bytes=peak.bytes),
            picture_s=seconds / max(len(at.intrinsics), 1),
            images_depth_scaled=by_depth,
            instances_3d=solid,
            rendered_ids=_rendered_ids(scene, contexts, seen, at),
            objects=objects,
        )

    prediction = fitted(pose_alignment_steps)
    return replace(prediction, aligned=fitted(also_aligned)) if also_aligned else prediction


def _placed(
    scene: FittedScene, sample: Sample, target_cameras: TargetCameras
) -> tuple[Cameras, Float[Tensor, "target 3 height width"] | None]:
    """The target cameras in the world of the scene; and the targets with the length of true depth.

    The latter is None at true cameras, and where no depth is known on one of both sides.
    """
    context, target = _cameras(sample.context), _cameras(sample.target)
    if target_cameras == "true":
        return target, None

    def place(scale: float) -> Cameras:
        return cameras_in_prediction(
            target, predicted_context=scene.cameras, true_context=context, scale=scale
        )

    by_depth = None
    true_depths = sample.context.depths
    assert true_depths is not None
    if scene.geometry is not None and (true_depths > 0).any():
        height, width = sample.target.images.shape[-2:]
        at = place(float(depth_scale(scene.geometry.depths[0], true_depths[0])))
        by_depth = render(scene.gaussians, at, height, width, near=NEAR, far=FAR).colors
    scale = baseline_scale(scene.cameras.cam_from_world, context.cam_from_world)
    return place(scale), by_depth


def _rendered_ids(
    scene: FittedScene, contexts: Seen | None, targets: Seen, cameras: Cameras
) -> RenderedIds | None:
    """Of the context views, then of the targets, if the former were asked for."""
    if contexts is None or contexts.masks is None or targets.masks is None:
        return None
    masks = (*contexts.masks, *targets.masks)
    return RenderedIds(
        ids=torch.stack([torch.from_numpy(each.ids) for each in masks]),
        depths=torch.cat([contexts.rendering.depths, targets.rendering.depths]),
        cameras=Cameras.concatenate([scene.cameras, cameras]),
    )


def _cameras(views: Views) -> Cameras:
    """True cameras of a batch of one, without the batch axis."""
    if views.cam_from_world is None or views.intrinsics is None:
        raise ValueError("cameras are missing; an evaluation sample carries the true ones")
    return Cameras(views.cam_from_world[0], views.intrinsics[0])
