"""What the settings of a stage answer when the rest of the program asks them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from instok3d.backbones.base import BackboneConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.cache.features import BackboneInput


@dataclass(frozen=True)
class DataNeeds:
    """What a stage learns from beside photos and cameras."""

    depths: bool = False
    """True depth, somewhere in every scene."""
    instances: bool = False
    """Instance ids, somewhere in every scene."""
    without_instances: str = ""
    """How to train on scenes without ids all the same, for the message that misses them."""


@dataclass(frozen=True)
class FirstWeights:
    """Where a new run begins that was given no first weights."""

    published: str | None = None
    """With these weights of the catalogue (`instok3d models list`)."""
    wanted: str | None = None
    """What the user has to give where nothing is published, such as "a trained backbone"; None =
    nothing, the run begins with random weights."""


@dataclass(frozen=True)
class NeededWeights:
    """Weights made elsewhere."""

    what: str
    """Of which network, for messages."""
    where: str | Path
    """Name in the catalogue, or a file."""


@dataclass(frozen=True)
class FrozenBackbone:
    """A backbone that a stage runs and does not train."""

    config: BackboneConfig
    inputs: tuple[BackboneInput, ...]
    """What it is shown in the training steps."""
    given: bool
    """Whether some steps show it true cameras and depth too."""


@dataclass(frozen=True)
class Workload:
    """What a training step of a stage computes."""

    backbone: BackboneConfig | None = None
    """Sizes of the model's geometry backbone, whose patches its other parts see; None = there is
    none, and every part sees every cell."""
    cell_side: int = 1
    """Of the squares of pixels that a model without a backbone sees at its finest."""
    backbone_runs: bool = True
    """False where its answers are read from a cache."""
    backbone_learns: bool = True
    tokenizer: TokenizerConfig | None = None
    """Sizes of the model's tokenizer."""
    lpips: bool = False
    """Whether renders of the target views are compared by LPIPS."""
    pixel_parts: tuple[str, ...] = ()
    """Top-level parts of the model that see every pixel of the context views."""


@dataclass(frozen=True)
class AveragedRun:
    """A run at its newest checkpoint, for export."""

    folder: Path
    weights: dict[str, Tensor]
    """Of the whole model; averaged ones where the run averages."""
    card: dict[str, Any]
    """What the exported file says of itself, as JSON values."""
