"""Stage "geometry": the nano backbone learns depth, matches and focal length from rooms.

First the network, then, on the matches of the finished network, the refinement of its depth.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Literal

import numpy as np
import torch
from PIL.Image import Image
from torch import Tensor, nn

from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.data.sample import Sample, photos_only
from instok3d.evaluation.geometry_errors import camera_errors, depth_errors
from instok3d.objectives.geometry import DepthLoss, depth_loss, geometry_loss
from instok3d.pictures import color_picture, contact_sheet, depth_picture, titled_rows
from instok3d.training.stages.answers import DataNeeds, FirstWeights, Workload
from instok3d.training.stages.stage import StageConfig, StepLoss
from instok3d.types import Views


@dataclass(frozen=True)
class GeometryStageConfig(StageConfig):
    """What the geometry stage trains."""

    backbone: NanoConfig = field(default_factory=NanoConfig)
    intrinsics_probability: float = 0.5
    """Share of the steps in which the network gets the intrinsics."""
    trained: Literal["network", "refinement"] = "network"
    """refinement: only the correction of depth by parallax, the network stays as it is."""

    def __post_init__(self):
        if self.trained == "refinement" and not self.backbone.refinement_layers:
            raise ValueError("backbone.refinement_layers is 0: there is no refinement to train")

    def build(self) -> "GeometryStage":
        """The stage of these settings."""
        return GeometryStage(self)

    def new_model(self) -> NanoBackbone:
        """A backbone of which the network or the refinement learns."""
        model = NanoBackbone(self.backbone)
        model.requires_grad_(self.trained == "network")
        if model.refinement is not None:
            model.refinement.requires_grad_(self.trained == "refinement")
        return model

    def workload(self) -> Workload:
        """That of the backbone alone."""
        return Workload(backbone=self.backbone)

    def data_needs(self) -> DataNeeds:
        """True depth."""
        return DataNeeds(depths=True)

    def first_weights(self) -> FirstWeights:
        """Random ones for the network; the refinement corrects a trained one."""
        return FirstWeights(wanted="a trained network" if self.trained == "refinement" else None)


class GeometryStage:
    """Depth up to scale, matches and focal length; cameras are solved from these."""

    def __init__(self, config: GeometryStageConfig) -> None:
        self.config = config

    @property
    def learns_whole(self) -> bool:
        """No: a step that tells the intrinsics does not ask for the focal length."""
        return False

    def build_model(self) -> NanoBackbone:
        """A new backbone."""
        return self.config.new_model()

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """Weights of a geometry run, or the backbone's of a tokenizer run.

        Weights that know no refinement leave it as it is.
        """
        prefix = "backbone."
        inner = {k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)}
        found = inner or dict(weights)
        if not any(name.startswith("refinement.") for name in found):
            new = {k: v for k, v in model.state_dict().items() if k.startswith("refinement.")}
            found = {**found, **new}
        model.load_state_dict(found)

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """The loss on the context views: of the network's answers, or of the refined depth."""
        assert isinstance(model, NanoBackbone)
        with_intrinsics = (
            np.random.default_rng([3, step]).random() < self.config.intrinsics_probability
        )
        loss = self._compare(model, sample.context, with_intrinsics=with_intrinsics)
        terms = {f.name: getattr(loss, f.name).detach() for f in fields(loss) if f.name != "total"}
        return StepLoss(loss.total, terms)

    def _compare(self, model: NanoBackbone, context: Views, *, with_intrinsics: bool) -> DepthLoss:
        photos = photos_only(context, keep_intrinsics=with_intrinsics)
        if self.config.trained == "refinement":
            assert context.depths is not None
            with torch.no_grad():
                raw = model.encode(photos)
                with torch.autocast(context.images.device.type, enabled=False):
                    intrinsics, matches = model.intrinsics(photos, raw), model.find_matches(raw)
            refined = model.refine(raw, photos, intrinsics, matches)
            return depth_loss(refined.log_depths, refined.log_confidences, context.depths)
        raw = model.encode(photos)
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
            losses.append(self._compare(model, context, with_intrinsics=False).total.item())
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
            "direction_deg": float(torch.cat(direction).median()),
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
        titles = ["first", "true depth", "predicted", "last", "true", "predicted"]
        return contact_sheet(titled_rows(rows, titles))
