"""Stage "segmenter": instances of single photos, for methods that are given masks.

Every photo of a batch, context or target, is a sample of its own; ids that hold across views play
no part. The loss is the tokenizer's grouping loss (Eq. 5) with one match for each photo.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float, Int
from PIL.Image import Image
from torch import Tensor, nn

from instok3d.baselines.segmenter import Segmenter, SegmenterConfig
from instok3d.baselines.segmenter_file import save_segmenter
from instok3d.data.sample import Sample
from instok3d.evaluation.instance_ap import ApSettings, average_precision, match_image
from instok3d.objectives.segmentation import segmentation_loss
from instok3d.pictures import color_picture, contact_sheet, id_picture, titled_rows
from instok3d.semantics.predictor import STRIDE
from instok3d.training.cache.features import of_backbone
from instok3d.training.stages.answers import AveragedRun, DataNeeds, FirstWeights, Workload
from instok3d.training.stages.stage import StageConfig, StepLoss

ASKED = ApSettings(min_instance_area=20)
"""As for rooms (docs/evaluation.md)."""


@dataclass(frozen=True)
class SegmenterStageConfig(StageConfig):
    """What the segmenter stage trains."""

    segmenter: SegmenterConfig = field(default_factory=SegmenterConfig)
    weights: str | None = "default"
    """Of a model or nano backbone in the catalogue (`instok3d models list`) whose encoder is where
    the network starts, unless the run is given others; None = random weights."""
    bce_weight: float = 1.0
    """As the tokenizer's."""
    dice_weight: float = 1.0

    def build(self) -> "SegmenterStage":
        """The stage of these settings."""
        return SegmenterStage(self)

    def new_model(self) -> Segmenter:
        """With random weights."""
        return Segmenter(self.segmenter)

    def workload(self) -> Workload:
        """No backbone: features of STRIDE x STRIDE pixels are the finest."""
        return Workload(cell_side=STRIDE)

    def data_needs(self) -> DataNeeds:
        """Ids."""
        return DataNeeds(instances=True)

    def first_weights(self) -> FirstWeights:
        """Those of the settings."""
        return FirstWeights(self.weights)

    def export(self, run: AveragedRun, output: Path, *, half: bool) -> None:
        """Write the segmenter, which `evaluate --masks segmenter:FILE` takes."""
        model = self.new_model()
        model.load_state_dict(run.weights)
        save_segmenter(model, output, card=run.card, half=half)


class SegmenterStage:
    """The grouping loss of single photos."""

    def __init__(self, config: SegmenterStageConfig) -> None:
        self.config = config

    @property
    def learns_whole(self) -> bool:
        """No: a batch without an instance asks for nothing."""
        return False

    def build_model(self) -> Segmenter:
        """A new segmenter."""
        return self.config.new_model()

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """All weights of a segmenter, else the encoder of a nano backbone, alone or of a model."""
        assert isinstance(model, Segmenter)
        if any(name.startswith("predictor.") for name in weights):
            model.load_state_dict(dict(weights))
        else:
            model.predictor.start_from_nano(of_backbone(weights))

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """BCE + Dice of each photo after its own match; the mean over photos."""
        assert isinstance(model, Segmenter)
        photos, ids = single_photos(sample)
        maps = model(photos)
        loss = segmentation_loss(
            maps[:, None, :-1], ids[:, None],
            bce_weight=self.config.bce_weight, dice_weight=self.config.dice_weight,
        )  # fmt: skip
        terms = {"bce": loss.bce, "dice": loss.dice, "void": maps[:, -1].mean()}
        return StepLoss(loss.total, {name: value.detach() for name, value in terms.items()})

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        """AP of single photos."""
        assert isinstance(model, Segmenter)
        matches = []
        for sample in samples:
            photos, ids = single_photos(sample)
            for found, true in zip(model.found(photos), ids.cpu().numpy(), strict=True):
                matches.append(match_image(true, found, ASKED))
        precision = average_precision(matches)
        return {"ap": precision.ap, "ap50": precision.ap50, "ap25": precision.ap25}

    def pictures(self, model: nn.Module, sample: Sample) -> Image:
        """Photos, true ids and found ids."""
        assert isinstance(model, Segmenter)
        photos, ids = single_photos(sample)
        rows = [
            [color_picture(photo), id_picture(true.clamp_min(0)), id_picture(found)]
            for photo, true, found in zip(photos, ids, model.masks(photos), strict=True)
        ]
        return contact_sheet(titled_rows(rows, ["photo", "true ids", "found"]))


def single_photos(
    sample: Sample,
) -> tuple[Float[Tensor, "photo 3 height width"], Int[Tensor, "photo height width"]]:
    """All photos of a batch, contexts first, and their ids."""
    photos = [views.images.flatten(0, 1) for views in (sample.context, sample.target)]
    ids = [ids.flatten(0, 1) for ids in (sample.context_instances, sample.target_instances)]
    return torch.cat(photos), torch.cat(ids)
