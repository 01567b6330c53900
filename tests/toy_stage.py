"""The smallest stage: one linear map from mean context colour to mean target depth.

Nothing in src knows of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor, nn

from instok3d.data.batches import BatchConfig
from instok3d.data.sample import Sample
from instok3d.files import write_safetensors
from instok3d.training.config import preset
from instok3d.training.stages.answers import AveragedRun, DataNeeds, Workload
from instok3d.training.stages.stage import StageConfig, StepLoss


@dataclass(frozen=True)
class ToyStageConfig(StageConfig):
    width: int = 8
    dropout: float = 0.5

    def build(self) -> "ToyStage":
        return ToyStage(dropout=self.dropout, width=self.width)

    def new_model(self) -> nn.Module:
        return nn.Sequential(
            nn.Linear(3, self.width), nn.Dropout(self.dropout), nn.Linear(self.width, 1), Gain()
        )

    def workload(self) -> Workload:
        return Workload()

    def data_needs(self) -> DataNeeds:
        return DataNeeds(depths=True)

    def export(self, run: AveragedRun, output: Path, *, half: bool) -> None:
        weights = {name: w.half() if half else w for name, w in run.weights.items()}
        write_safetensors(output, weights, {"name": run.card["name"]})


TINY = replace(
    preset("nano-geometry"),
    stage=ToyStageConfig(),
    batches=BatchConfig(batch_size=2),
    steps=6,
    warmup_steps=2,
    lr=1e-2,
    holdout=2,
    log_every_steps=2,
    validate_every_s=1e9,
    checkpoint_every_s=1e9,
    amp=False,
)


class Gain(nn.Module):
    """A scalar parameter, as the models have some; FSDP cannot cut it in parts."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.tensor(1.5))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.gain


class ToyStage:
    def __init__(
        self,
        bad_step: int | None = None,
        bad_gradient_step: int | None = None,
        dropout: float = 0.5,
        width: int = 8,
    ) -> None:
        self.config = ToyStageConfig(width, dropout)
        self.bad_step = bad_step
        self.bad_gradient_step = bad_gradient_step

    learns_whole = True

    def build_model(self) -> nn.Module:
        return self.config.new_model()

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        model.load_state_dict(dict(weights))

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        error = (self._predict(model, sample) - sample.target.depths.mean((1, 2, 3))).square()
        total = error.mean()
        if step == self.bad_step:
            total = total * torch.nan
        if step == self.bad_gradient_step:
            total = total + (total - total.detach()).clamp_min(0).sqrt()  # gradient of sqrt at 0
        return StepLoss(total, {"error": error.mean().detach()})

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        assert not model.training
        torch.rand(3)  # validation may use the generator without disturbing the run
        return {"error": sum(self.loss(model, s, -1).total.item() for s in samples) / len(samples)}

    def pictures(self, model: nn.Module, sample: Sample) -> Image.Image:
        return Image.new("RGB", (4, 4))

    def _predict(self, model: nn.Module, sample: Sample) -> Tensor:
        return model(sample.context.images.mean((1, 3, 4)))[:, 0]
