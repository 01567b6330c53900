"""What a training stage must offer to the loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from PIL.Image import Image
from torch import Tensor, nn

from instok3d.data.sample import Sample


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
