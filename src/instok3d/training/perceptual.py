"""LPIPS as the stages use it: its settings, the weights it needs, its network."""

from pathlib import Path
from typing import Protocol, runtime_checkable

from instok3d.objectives.lpips import Lpips, load_lpips
from instok3d.training.stages.answers import NeededWeights
from instok3d.weights import weights_path


@runtime_checkable
class LpipsSettings(Protocol):
    """Settings of a stage whose loss may have a perceptual term."""

    @property
    def lpips_weight(self) -> float:
        """Of the perceptual term in the loss; 0 = none."""
        ...

    @property
    def lpips_file(self) -> Path | None:
        """Its weights as safetensors; None = those of the catalogue."""
        ...

    @property
    def lpips_name(self) -> str:
        """In the catalogue (`instok3d models list`)."""
        ...


def lpips_needed(settings: LpipsSettings) -> tuple[NeededWeights, ...]:
    """The weights of LPIPS, or none where its weight in the loss is 0."""
    if settings.lpips_weight <= 0:
        return ()
    return (NeededWeights("LPIPS", settings.lpips_file or settings.lpips_name),)


def lpips_network(settings: LpipsSettings) -> Lpips | None:
    """The network of the perceptual loss; None where its weight is 0.

    Raises:
        MissingWeightsError: Its weights are not on this machine; says how to get them.
        ValueError: The file holds something else.
    """
    for needed in lpips_needed(settings):
        where = needed.where
        return load_lpips(where if isinstance(where, Path) else weights_path(where))
    return None
