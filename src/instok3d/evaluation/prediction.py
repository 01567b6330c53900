"""What a model makes of one sample: pictures and masks at the target cameras, and its geometry."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.data.sample import Sample, photos_only
from instok3d.evaluation.camera_refinement import refined_cameras
from instok3d.evaluation.instance_ap import PredictedMasks, predicted_masks
from instok3d.evaluation.object_quality import FoundObjects, found_objects
from instok3d.geometry.camera_alignment import (
    TargetCameras,
    baseline_scale,
    cameras_in_prediction,
)
from instok3d.geometry.similarity import depth_scale
from instok3d.refinement.assignment import reassigned
from instok3d.refinement.optimization import refine_gaussians
from instok3d.refinement.settings import RefinementSettings
from instok3d.render import render
from instok3d.scene.clean_up import cleaned
from instok3d.scene.record import SceneTokens
from instok3d.types import Cameras, Geometry, Rendering, TokenGroups, Views

GeometryMode = Literal["predicted", "intrinsics", "given"]
"""'predicted': the model sees bare photos. 'intrinsics': photos and their true intrinsics, as the
paper's model does. 'given': true cameras and depth too."""

NEAR, FAR = 0.05, 100.0
"""z-depths between which scenes are refined and rendered."""

Model = Callable[[Views], TokenGroups]
"""A Tokenizer, or whatever answers like one."""


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
    masks: tuple[PredictedMasks, ...]
    """For each target view."""
    num_groups_used: int
    """Groups that win at least one anchor (against each other and the void)."""
    cameras: Cameras
    """The target cameras in the predicted world, as they were rendered."""
    geometry: Geometry
    """Of the context views, batch of one."""
    images_depth_scaled: Float[Tensor, "target 3 height width"] | None
    """The targets rendered with the length fitted to true depth instead of baselines: a
    diagnostic that says how much of an error is the length alone. None at true target cameras and
    where no depth is known."""
    rendered_ids: RenderedIds | None = None
    """Of the context views at their predicted cameras, then of the targets; if asked for."""
    objects: FoundObjects | None = None
    """Of the context views at their predicted cameras; if asked for."""
    aligned: "Prediction | None" = None
    """The same scene with each target camera fitted to its photo; if asked for."""


@torch.no_grad()
def predict(
    model: Model,
    sample: Sample,
    mode: GeometryMode,
    *,
    target_cameras: TargetCameras = "aligned",
    pose_alignment_steps: int = 0,
    alpha_min: float = 0.0,
    refine: int = 0,
    clean_up: bool = False,
    with_ids: bool = False,
    with_objects: bool = False,
    also_aligned: int = 0,
) -> Prediction:
    """Run the model on the context views of a sample and render its scene at the targets.

    Args:
        model: Photos in, token groups out.
        sample: A batch of one.
        mode: What of the context views the model sees.
        target_cameras: Where the targets are rendered; with given cameras always at the true ones.
        pose_alignment_steps: See `camera_refinement.refined_cameras`; 0 leaves it out.
        alpha_min: Pixels covered no more than this belong to no group.
        refine: Steps of refinement on the context photos, at the cameras of the prediction.
        clean_up: Make whole objects of the groups, as `reconstruct` does by default.
        with_ids: Also render the ids of the context views, for `rendered_ids`.
        with_objects: Also find the objects of the scene in the context views, for `objects`.
        also_aligned: Steps of `camera_refinement.refined_cameras` for `aligned`; 0 leaves it out.

    Raises:
        ValueError: The sample is no batch of one, or lacks true cameras or depth; or the model's
            answer is not finite.
    """
    batch, _, _, height, width = sample.target.images.shape
    if batch != 1:
        raise ValueError(f"predict needs a sample of one scene, got {batch}")
    context, target = _cameras(sample.context), _cameras(sample.target)
    if sample.context.depths is None:
        raise ValueError("context.depths is missing; an evaluation sample carries true depth")
    shown = sample.context
    if mode != "given":
        shown = photos_only(shown, keep_intrinsics=mode == "intrinsics")
    groups = model(shown)
    _check_finite(groups, sample.names[0])
    gaussians, pi = groups.gaussians.scene(0), groups.assignment[0]
    predicted = groups.geometry.cameras.scene(0)
    if refine:
        gaussians = refine_gaussians(
            gaussians, predicted, sample.context.images[0], RefinementSettings(steps=refine),
            near=NEAR, far=FAR,
        ).gaussians  # fmt: skip
        gaussians = reassigned(
            gaussians, pi, groups.anchors.positions[0], predicted, height, width,
            near=NEAR, far=FAR,
        )  # fmt: skip

    if clean_up:
        tokens = SceneTokens(
            groups.anchors.positions[0], groups.anchors.tokens[0], groups.tokens[0], pi
        )
        whole = cleaned(gaussians, tokens, predicted, height, width, near=NEAR, far=FAR)
        gaussians, pi = whole.gaussians, whole.tokens.assignment

    def place(scale: float) -> Cameras:
        return cameras_in_prediction(
            target, predicted_context=predicted, true_context=context, scale=scale
        )

    by_depth = None
    if mode == "given" or target_cameras == "true":
        cameras = target
    else:
        cameras = place(baseline_scale(predicted.cam_from_world, context.cam_from_world))
        if (sample.context.depths > 0).any():
            scale = float(depth_scale(groups.geometry.depths[0], sample.context.depths[0]))
            by_depth = render(gaussians, place(scale), height, width, near=NEAR, far=FAR).colors
    anchor_features = pi[:, :-1].contiguous()

    def seen_from(cameras: Cameras) -> tuple[Rendering, tuple[PredictedMasks, ...]]:
        rendering = render(
            gaussians, cameras, height, width, anchor_features=anchor_features, near=NEAR, far=FAR
        )
        return rendering, _masks(rendering, alpha_min)

    contexts = seen_from(predicted) if with_ids else None
    objects = None
    if with_objects:
        objects = found_objects(gaussians, pi, predicted, height, width, near=NEAR, far=FAR)
    winners = pi.argmax(dim=-1)

    def fitted(steps: int) -> Prediction:
        at = refined_cameras(gaussians, cameras, sample.target.images[0], steps=steps)
        rendering, masks = seen_from(at)
        rendered_ids = None
        if contexts is not None:
            rendered_ids = RenderedIds(
                ids=torch.stack([torch.from_numpy(each.ids) for each in (*contexts[1], *masks)]),
                depths=torch.cat([contexts[0].depths, rendering.depths]),
                cameras=Cameras.concatenate([predicted, at]),
            )
        return Prediction(
            images=rendering.colors,
            masks=masks,
            num_groups_used=len(winners[winners < pi.shape[-1] - 1].unique()),
            cameras=at,
            geometry=groups.geometry,
            images_depth_scaled=by_depth,
            rendered_ids=rendered_ids,
            objects=objects,
        )

    prediction = fitted(pose_alignment_steps)
    return replace(prediction, aligned=fitted(also_aligned)) if also_aligned else prediction


def _masks(rendering: Rendering, alpha_min: float) -> tuple[PredictedMasks, ...]:
    assert rendering.features is not None
    return tuple(
        predicted_masks(maps, alphas, alpha_min=alpha_min)
        for maps, alphas in zip(rendering.features, rendering.alphas, strict=True)
    )


def _cameras(views: Views) -> Cameras:
    """True cameras of a batch of one, without the batch axis."""
    if views.cam_from_world is None or views.intrinsics is None:
        raise ValueError("cameras are missing; an evaluation sample carries the true ones")
    return Cameras(views.cam_from_world[0], views.intrinsics[0])


def _check_finite(groups: TokenGroups, name: str) -> None:
    """A renderer leaves out what is not finite, so the picture alone would not tell.

    Points and features may be so: who uses them knows that some are unknown.
    """
    geometry = groups.geometry
    parts = {
        **vars(groups.gaussians),
        "assignment": groups.assignment,
        "depths": geometry.depths,
        **{f"{part} of the cameras": value for part, value in vars(geometry.cameras).items()},
    }
    wrong = [part for part, values in parts.items() if not values.isfinite().all()]
    if wrong:
        raise ValueError(
            f"the model's answer to {name} is not finite and cannot be measured: look for NaN in "
            f"the model's weights; not finite are {', '.join(wrong)}"
        )
