"""What `instok3d evaluate --method` measures."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Int
from torch import Tensor

from instok3d.baselines.registry import METHODS, MethodName
from instok3d.baselines.settings import SplatSettings
from instok3d.data.sample import Sample
from instok3d.evaluation.methods import Method
from instok3d.evaluation.tokenizer_method import Model
from instok3d.files import sha256_of
from instok3d.model.files import DEFAULT_MODEL, load_model, read_card


@dataclass(frozen=True)
class Measured:
    """A method with its name in the report."""

    method: Model | Method
    name: str
    seed: int | None
    """Of its training or optimisation; None where nobody knows."""
    masks_of: Callable[[Sample], Int[Tensor, "view height width"]] | None = None
    """For a method that needs masks."""


def measured_model(model: Path | None) -> Measured:
    """The tokenizer of a file, None for the default model.

    Raises:
        FileNotFoundError, ValueError: See `load_model`.
    """
    file = DEFAULT_MODEL if model is None else model
    tokenizer = load_model(model)
    seed = read_card(model).get("config", {}).get("seed")
    return Measured(tokenizer, f"{file.name} sha256:{sha256_of(file)[:12]}", seed)


def measured_method(name: MethodName, *, steps: int | None) -> Measured:
    """A method that optimises each scene; masks are the true ones.

    Args:
        name: Of the method.
        steps: Of the optimisation; None takes those of the method.

    Raises:
        ValueError: No such number of steps can be done.
    """
    settings = SplatSettings() if steps is None else SplatSettings(steps=steps)
    method = METHODS[name](settings)
    title = f"{name}, {settings.steps} steps"
    if "masks" not in method.needs:
        return Measured(method, title, settings.seed)
    return Measured(method, f"{title}, masks true", settings.seed, _true_masks)


def _true_masks(sample: Sample) -> Int[Tensor, "view height width"]:
    return sample.context_instances[0]


def check_options(name: MethodName, protocol: str, given: dict[str, bool]) -> None:
    """Refuse what a method that optimises each scene cannot follow.

    Args:
        name: Of the method.
        protocol: Of the evaluation.
        given: Options that are of the tokenizer alone, and whether each was given.

    Raises:
        ValueError: Says which, and what to do.
    """
    if not protocol.startswith(("rooms-", "scannet-")):
        raise ValueError(
            f"--method {name} needs cameras, depth and masks, which {protocol} does not have; "
            "choose a protocol of rooms or ScanNet"
        )
    wrong = [option for option, is_given in given.items() if is_given]
    if wrong:
        raise ValueError(
            f"{wrong[0]} is of the tokenizer; leave it out with --method {name}, which optimises "
            "each scene from given cameras and depth"
        )
