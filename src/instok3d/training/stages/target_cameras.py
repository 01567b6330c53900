"""Where a stage renders its targets: at the true cameras, or these in the predicted world."""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.geometry.camera_alignment import (
    TargetCameras,
    baseline_scale,
    cameras_in_prediction,
)
from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.similarity import depth_scale
from instok3d.types import Cameras, Geometry, Views

SHORTEST_BASELINE = 0.02
"""Scene units, true or predicted: context cameras closer together say nothing of the scale."""


ScaleFrom = Literal["baselines", "depths"]
"""How aligned target cameras find their length in the predicted world: from the distances of the
context cameras, as in the evaluation (depths where these stand together), or always from the true
depths."""


def need_depths(kind: TargetCameras, scale_from: ScaleFrom) -> bool:
    """Whether the true depths of the contexts have to be known."""
    return kind == "aligned" and scale_from == "depths"


def cameras_of_targets(
    kind: TargetCameras,
    geometry: Geometry,
    sample: Sample,
    scale_from: ScaleFrom,
) -> Cameras:
    """The cameras of the target views in the world of the first context view.

    Args:
        kind: Which cameras.
        geometry: Predicted from the context views.
        sample: With true cameras; aligned cameras also need true depths of the contexts.
        scale_from: Of no use to true cameras.
    """
    if kind == "true":
        return _cameras(sample.target)
    return target_cameras_in_prediction(geometry, sample.context, sample.target, scale_from)


@torch.no_grad()
def target_cameras_in_prediction(
    geometry: Geometry, context: Views, target: Views, scale_from: ScaleFrom
) -> Cameras:
    """The target cameras of each scene, in its predicted world and with its focal lengths.

    Args:
        geometry: Predicted from the context views.
        context: Those views with true cameras and depths.
        target: Views with true cameras in the same world.
        scale_from: What fixes the length of a predicted unit.
    """
    true_context, true_target = _cameras(context), _cameras(target)
    assert context.depths is not None
    cam_from_world, intrinsics = [], []
    for scene in range(len(context.images)):
        predicted = geometry.cameras.cam_from_world[scene].float()
        true = true_context.cam_from_world[scene]
        apart = min(map(_path, (predicted, true))) > SHORTEST_BASELINE
        # Without depth, cameras that are predicted at one place bring the targets there too.
        if scale_from == "baselines" and (apart or not (context.depths[scene] > 0).any()):
            scale = baseline_scale(predicted, true)
        else:
            scale = float(depth_scale(geometry.depths[scene].float(), context.depths[scene]))
        cameras = cameras_in_prediction(
            Cameras(true_target.cam_from_world[scene], true_target.intrinsics[scene]),
            predicted_context=Cameras(predicted, geometry.cameras.intrinsics[scene].float()),
            true_context=Cameras(true, true_context.intrinsics[scene]),
            scale=scale,
        )
        cam_from_world.append(cameras.cam_from_world)
        intrinsics.append(cameras.intrinsics)
    return Cameras(torch.stack(cam_from_world), torch.stack(intrinsics))


def _cameras(views: Views) -> Cameras:
    assert views.cam_from_world is not None
    assert views.intrinsics is not None
    return Cameras(views.cam_from_world, views.intrinsics)


def _path(cam_from_world: Float[Tensor, "view 4 4"]) -> float:
    return float(torch.pdist(invert_rigid(cam_from_world)[:, :3, 3]).sum())
