"""Stage "geometry": the nano backbone learns depth, matches and focal length from rooms."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
import torch
from PIL.Image import Image
from torch import Tensor, nn

from instok3d.data.sample import Sample, photos_only
from instok3d.evaluation.geometry_errors import camera_errors, depth_errors
from instok3d.model.backbone.nano import NanoBackbone, NanoConfig
from instok3d.objectives.geometry import GeometryLoss, geometry_loss
from instok3d.training.pictures import color_picture, contact_sheet, depth_picture
from instok3d.training.stages import StepLoss
from instok3d.types import Views


@dataclass(frozen=True)
class GeometryStageConfig:
    """What the geometry stage trains."""

    backbone: NanoConfig = field(default_factory=NanoConfig)
    intrinsics_probability: float = 0.5
    """Share of the steps in which the network is told the intrinsics."""


class GeometryStage:
    """Depth up to scale, matches and focal length; cameras are solved from these."""

    def __init__(self, config: GeometryStageConfig) -> None:
        self.config = config

    def build_model(self) -> NanoBackbone:
        """A new backbone."""
        return NanoBackbone(self.config.backbone)

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """Weights of a geometry run, or the backbone's of a tokenizer run."""
        prefix = "backbone."
        inner = {k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)}
        model.load_state_dict(inner or dict(weights))

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """The geometry loss on the context views."""
        assert isinstance(model, NanoBackbone)
        told = np.random.default_rng([3, step]).random() < self.config.intrinsics_probability
        loss = self._compare(model, sample.context, told=told)
        terms = {f.name: getattr(loss, f.name).detach() for f in fields(loss) if f.name != "total"}
        return StepLoss(loss.total, terms)

    def _compare(self, model: NanoBackbone, context: Views, *, told: bool) -> GeometryLoss:
        raw = model.encode(photos_only(context, keep_intrinsics=told))
        with torch.autocast(context.images.device.type, enabled=False):
            return geometry_loss(model, raw, context)

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        """Errors from photos alone: depth after one scale a scene, relative cameras."""
        assert isinstance(model, NanoBackbone)
        depth, rotation, direction, losses = [], [], [], []
        for sample in samples:
            context = sample.context
            assert context.depths is not None
            assert context.cam_from_world is not None
            geometry = model(photos_only(context))
            losses.append(self._compare(model, context, told=False).total.item())
            for scene in range(len(context.images)):
                errors = depth_errors(geometry.depths[scene], context.depths[scene])
                depth.append(errors.scaled)
                cameras = camera_errors(
                    geometry.cameras.cam_from_world[scene], context.cam_from_world[scene]
                )
                rotation.append(cameras.rotation_deg)
                direction.append(cameras.direction_deg)
        return {
            "loss": float(np.mean(losses)),
            "depth_rel": float(np.mean(depth)),
            "rotation_deg": float(torch.cat(rotation).median()),
            "rotation_deg_p90": float(torch.cat(rotation).quantile(0.9)),
            "direction_deg": float(torch.cat(direction).nanmedian()),
        }

    def pictures(self, model: nn.Module, sample: Sample) -> Image:
        """First and last context with true and predicted depth, brought to one scale."""
        context = sample.context
        assert context.depths is not None
        geometry = model(photos_only(context))
        rows = []
        for scene in range(len(context.images)):
            true = context.depths[scene]
            predicted = geometry.depths[scene].float()
            scale = depth_errors(predicted, true).scale
            farthest = float(true.max())
            rows.append([])
            for view in (0, -1):
                rows[-1] += [
                    color_picture(context.images[scene, view]),
                    depth_picture(true[view], farthest=farthest),
                    depth_picture(predicted[view] * scale, farthest=farthest),
                ]
        return contact_sheet(
            rows, ["first", "true depth", "predicted", "last", "true", "predicted"]
        )
