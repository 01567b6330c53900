"""What a stage of training is: its settings, which answer for it before it runs, and its loss.

A new stage is one file in this folder with a subclass of `StageConfig` and a `Stage`, and a preset
in `training.config`. Loop, checkpoints, plan, command line and export ask through these two alone.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from PIL.Image import Image
from torch import Tensor, nn

from instok3d.backbones.base import BackboneConfig
from instok3d.data.sample import Sample
from instok3d.training.stages.answers import (
    AveragedRun,
    DataNeeds,
    FirstWeights,
    FrozenBackbone,
    NeededWeights,
    Workload,
)


@dataclass(frozen=True)
class StepLoss:
    """The loss of one batch."""

    total: Float[Tensor, ""]
    """What is differentiated."""
    terms: dict[str, Float[Tensor, ""]]
    """Its parts and other figures for the log, detached."""


@runtime_checkable
class Stage(Protocol):
    """One stage of training: the model, its loss, and how to see whether it learns.

    The loop calls `loss` and `validate` under autocast where the run asks for it; a stage turns
    it off for what needs float32. `validate` and `pictures` run without gradients on the
    averaged weights.
    """

    @property
    def learns_whole(self) -> bool:
        """Whether the loss of every step depends on every trained parameter.

        Otherwise DDP looks for those that it does not depend on, and torch warns if there are none.
        """
        ...

    def build_model(self) -> nn.Module:
        """A new model; parameters that are not to be trained do not require gradients."""
        ...

    def load_initial(self, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
        """Start from the weights of another run, of this stage or of the stage before."""
        ...

    def loss(self, model: nn.Module, sample: Sample, step: int) -> StepLoss:
        """The loss of a batch. Random choices follow from the step or torch's generator alone."""
        ...

    def validate(self, model: nn.Module, samples: Sequence[Sample]) -> dict[str, float]:
        """Figures of merit over all samples together."""
        ...

    def pictures(self, model: nn.Module, sample: Sample) -> Image:
        """A contact sheet of one batch."""
        ...


@dataclass(frozen=True)
class StageConfig(ABC):
    """Settings of a stage; subclasses are frozen dataclasses named `<Name>StageConfig`.

    The methods answer from the settings alone: no file is read and nothing is loaded, except by
    `build` and `export`.
    """

    @property
    def name(self) -> str:
        """What the stage is called: the class without StageConfig, in lower case."""
        return type(self).__name__.removesuffix("StageConfig").lower()

    @abstractmethod
    def build(self) -> Stage:
        """The stage itself.

        Raises:
            MissingWeightsError: Of `other_weights` some are not on this machine.
            ValueError: Settings contradict each other.
        """

    @abstractmethod
    def new_model(self) -> nn.Module:
        """A model of these sizes with random weights.

        Parameters that are not to be trained do not require gradients.
        """

    @abstractmethod
    def workload(self) -> Workload:
        """What a training step computes, for the estimate of time and memory."""

    def picture_side(self) -> int:
        """Height and width of the pictures that the backbone is made for, pixels."""
        backbone = self.workload().backbone
        return BackboneConfig().image_side if backbone is None else backbone.image_side

    def data_needs(self) -> DataNeeds:
        """What every scene must have beside photos and cameras."""
        return DataNeeds()

    def first_weights(self) -> FirstWeights:
        """Where a new run begins; by default with random weights."""
        return FirstWeights()

    def other_weights(self) -> tuple[NeededWeights, ...]:
        """Weights made elsewhere that the stage needs beside those that it begins with."""
        return ()

    def learns_unit(self) -> bool:
        """Whether the model learns to answer in the unit of the data set's cameras."""
        return False

    def frozen_backbone(self) -> FrozenBackbone | None:
        """The backbone that the stage runs and does not train; its answers can be cached."""
        return None

    def cache_folder(self) -> Path | None:
        """Folder of cached features that the stage reads in place of running its backbone."""
        return None

    def export(self, run: AveragedRun, output: Path, *, half: bool) -> None:
        """Write what the stage is trained for as one file.

        Args:
            run: A run of this stage.
            output: The .safetensors file; its folder exists.
            half: Store float16.

        Raises:
            ValueError: There is nothing to export of this stage, or weights are not finite.
        """
        raise ValueError(
            f"{run.folder} is a {self.name} run, which is given on by its folder (--init-from); "
            "export a tokenizer run or an adapt run"
        )
