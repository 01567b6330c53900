"""The whole state of a run in one file: what is needed to go on as if it had never stopped.

Tensors are stored whole, however many processes shared them, so that a run can go on with another
number of processes or another strategy.
"""

import json
import math
import random
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from instok3d.files import replacing
from instok3d.reading import (
    UNREADABLE,
    naming_damage,
    number,
    parse_json,
    reason_of,
    text,
    whole_number,
)
from instok3d.training.distributed import ALONE, Processes, local, sharded_like, whole
from instok3d.version import current_commit
from instok3d.weights.reading import read_weights_file

REMEDY = "remove it to go on from the one before"
KEPT = 2
"""Checkpoints that stay: should the newest be torn, the one before it takes over."""


class WeightAverage:
    """Exponential moving average of a model's trained parameters; with decay 0 none is kept.

    Early on the decay is (1 + step) / (10 + step), so that the average forgets the random start.
    """

    def __init__(self, model: nn.Module, decay: float) -> None:
        self.decay = decay
        trained = _trained(model) if decay else {}
        self.values = {name: p.detach().clone() for name, p in trained.items()}

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        """Move the average towards the weights after the update of `step`."""
        keep = min(self.decay, (1 + step) / (10 + step))
        trained = _trained(model)
        for name, value in self.values.items():
            local(value).lerp_(local(trained[name].detach()), 1 - keep)

    @contextmanager
    def applied(self, model: nn.Module) -> Iterator[None]:
        """The model with the averaged weights; its own come back at the end."""
        trained = _trained(model)
        own = {name: trained[name].detach().clone() for name in self.values}
        _copy(self.values, trained)
        try:
            yield
        finally:
            _copy(own, trained)


def _trained(model: nn.Module) -> dict[str, nn.Parameter]:
    return {name: p for name, p in model.named_parameters() if p.requires_grad}


@torch.no_grad()
def _copy(source: Mapping[str, Tensor], target: Mapping[str, Tensor]) -> None:
    for name, tensor in source.items():
        target[name].copy_(tensor)


@dataclass
class RunState:
    """Everything that changes while a run goes on."""

    model: nn.Module
    optimizer: torch.optim.Optimizer
    average: WeightAverage
    step: int = 0
    """Updates done; also the position in the data, which is a function of it."""
    elapsed_s: float = 0.0
    skipped: int = 0
    """Updates left out because of a non-finite gradient."""
    skipped_in_a_row: int = 0
    scene_names: list[str] = field(default_factory=list)
    """The scenes of the data set that this run uses, held-out ones first."""
    image_size: tuple[int, int] | None = None
    """Height and width of their pictures; known to the first process."""


def save_checkpoint(
    folder: Path, state: RunState, config: dict[str, Any], processes: Processes = ALONE
) -> Path:
    """Write checkpoints/step_N.pt, atomically, and remove all but the last two.

    All processes must call it; the first one writes.

    Args:
        folder: The run.
        state: Its state; RNGs of torch, numpy and python are taken from each process.
        config: Settings of the run, for a reader.
        processes: Those of the run.
    """
    checkpoints = folder / "checkpoints"
    path = checkpoints / f"step_{state.step:08d}.pt"
    content = {
        "version": 2,
        "step": state.step,
        "elapsed_s": state.elapsed_s,
        "skipped": state.skipped,
        "skipped_in_a_row": state.skipped_in_a_row,
        "scene_names": state.scene_names,
        "image_size": state.image_size,
        "config": json.dumps(config),
        "commit": current_commit(),
        "model": whole(dict(state.model.state_dict()), keep=processes.is_first),
        "optimizer": whole(state.optimizer.state_dict(), keep=processes.is_first),
        "average": whole(state.average.values, keep=processes.is_first),
        "random": processes.gather(_random_state()),
    }
    if not processes.is_first:
        return path
    checkpoints.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        torch.save(content, part)
    for old in sorted(checkpoints.glob("step_*.pt"))[:-KEPT]:
        old.unlink()
    return path


def has_checkpoint(folder: Path) -> bool:
    """Whether a run has got as far as its first checkpoint, whole or torn."""
    return any((folder / "checkpoints").glob("step_*.pt"))


def read_checkpoint(folder: Path) -> dict[str, Any]:
    """The newest checkpoint of a run that is whole; a torn one is passed over with a warning.

    Raises:
        FileNotFoundError: The run has no checkpoint.
        ValueError: None of its checkpoints can be read.
    """
    paths = sorted((folder / "checkpoints").glob("step_*.pt"), reverse=True)
    if not paths:
        raise FileNotFoundError(f"no checkpoint in {folder / 'checkpoints'}: nothing to go on from")
    reasons = []
    for path in paths:
        try:
            return _read(path)
        except ValueError as error:
            reasons.append(str(error))
            warnings.warn(f"{error}; trying the one before", stacklevel=2)
    raise ValueError(
        f"all checkpoints in {folder / 'checkpoints'} are damaged ({reasons[0]}); start the run "
        "anew"
    )


def _read(path: Path) -> dict[str, Any]:
    """One checkpoint.

    Raises:
        ValueError: It is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:  # torch.load does not look at the checksums
            if broken := archive.testzip():
                raise zipfile.BadZipFile(f"wrong checksum of {broken}")
        checkpoint = torch.load(path, map_location="cpu", mmap=True, weights_only=True)
        checkpoint = _upgraded(checkpoint)
        _check(checkpoint)
    except (*UNREADABLE, MemoryError) as error:
        raise ValueError(f"{path.name} is damaged ({reason_of(error)})") from error
    return {**checkpoint, "path": str(path)}


def _upgraded(checkpoint: dict[str, Any]) -> dict[str, Any]:
    """A checkpoint of version 1 knew rooms by their seeds and had one process."""
    if "scene_seeds" in checkpoint:
        checkpoint["scene_names"] = [str(seed) for seed in checkpoint.pop("scene_seeds")]
    if isinstance(checkpoint["random"], dict):
        checkpoint["random"] = [checkpoint["random"]]
    return checkpoint


def _check(checkpoint: dict[str, Any]) -> None:
    """Fail unless everything is there and can be."""
    for key in ("step", "skipped", "skipped_in_a_row"):
        whole_number(checkpoint[key])
    if not 0 <= number(checkpoint["elapsed_s"]) < math.inf:
        raise ValueError(f"elapsed_s is {checkpoint['elapsed_s']}")
    for name in checkpoint["scene_names"]:
        text(name)
    text(checkpoint["commit"])
    if not isinstance(parse_json(checkpoint["config"], "its config", "start anew"), dict):
        raise ValueError("its config is no JSON object")
    if (size := checkpoint.get("image_size")) is not None:
        for side in size:
            whole_number(side, least=1)
    for part in ("model", "average"):
        for name, value in checkpoint[part].items():
            if not isinstance(value, Tensor) or not value.isfinite().all():
                raise ValueError(f"{name} in {part} is no tensor of finite numbers")
    optimizer = checkpoint["optimizer"]
    for values in optimizer["state"].values():
        for name, value in values.items():
            if isinstance(value, Tensor) and value.isnan().any():
                raise ValueError(f"{name} of the optimizer is not a number")
    if not isinstance(optimizer["param_groups"], list) or not checkpoint["random"]:
        raise ValueError("it lacks groups of parameters or random states")


def restore_weights(model: nn.Module, checkpoint: dict[str, Any]) -> None:
    """Put the weights of a checkpoint into a model that is not yet shared between processes.

    Raises:
        ValueError: The run's model has other sizes than the one that was built.
    """
    try:
        model.load_state_dict(checkpoint["model"])
    except RuntimeError as error:
        raise ValueError(
            f"the run's weights in {checkpoint.get('path', 'its checkpoint')} do not fit the "
            f"model that its settings ask for ({reason_of(error)}); sizes "
            "cannot be changed on resuming"
        ) from error


def restore(state: RunState, checkpoint: dict[str, Any], processes: Processes = ALONE) -> None:
    """Put all but the weights into a freshly built state and into this process's RNGs.

    With another number of processes than before, their RNGs start anew, with a warning: dropout
    and the like then differ from those of a run that did not stop.
    """
    path = checkpoint.get("path", "the checkpoint")
    with naming_damage(path, REMEDY):
        saved = _sharded_optimizer(state.optimizer, checkpoint["optimizer"])
        state.optimizer.load_state_dict(saved)
    for name, value in state.average.values.items():
        # A run that had no average until now begins it with its weights.
        saved = checkpoint["average"].get(name, checkpoint["model"][name])
        if saved.shape != value.shape:
            raise ValueError(
                f"{path} is damaged (the average of {name} has the shape {tuple(saved.shape)}, "
                f"wanted {tuple(value.shape)}); {REMEDY}"
            )
        local(value).copy_(local(sharded_like(saved, value)))
    state.step = checkpoint["step"]
    state.elapsed_s = checkpoint["elapsed_s"]
    state.skipped = checkpoint["skipped"]
    state.skipped_in_a_row = checkpoint["skipped_in_a_row"]
    state.scene_names = checkpoint["scene_names"]
    if len(checkpoint["random"]) == processes.count:
        with naming_damage(path, REMEDY):
            _set_random_state(checkpoint["random"][processes.rank])
    else:
        warnings.warn(
            f"the run had {len(checkpoint['random'])} processes and now has {processes.count}: "
            "random numbers start anew",
            stacklevel=2,
        )


def _sharded_optimizer(optimizer: torch.optim.Optimizer, saved: dict[str, Any]) -> dict[str, Any]:
    """The saved state with each moment sharded as the parameter is that it belongs to."""
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    state = {
        number: {
            # The optimizer itself knows where it wants its count of steps.
            name: value.clone() if name == "step" else sharded_like(value, parameters[number])
            for name, value in values.items()
        }
        for number, values in saved["state"].items()
    }
    return {"state": state, "param_groups": saved["param_groups"]}


def read_weights(path: Path) -> dict[str, Tensor]:
    """Weights to start another run from: averaged ones of a run folder or a .safetensors file.

    Raises:
        FileNotFoundError: There is nothing at the path, or no checkpoint in the run.
        ValueError: The file is damaged.
    """
    if path.is_dir():
        checkpoint = read_checkpoint(path)
        return {**checkpoint["model"], **checkpoint["average"]}
    if not path.is_file():
        raise FileNotFoundError(f"no run folder and no .safetensors file at {path}")
    return read_weights_file(path, "export or fetch it again")[0]


def _random_state() -> dict[str, Any]:
    kind, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)
    state = {
        "torch": torch.get_rng_state(),
        # No numpy array may stand in a file that is read with weights_only.
        "numpy": (kind, torch.tensor(np.asarray(keys).tolist()), position, has_gauss, gauss),
        "python": random.getstate(),
    }
    if torch.cuda.is_available():
        state["cuda"] = torch.cuda.get_rng_state_all()
    return state


def _set_random_state(state: dict[str, Any]) -> None:
    kind, keys, position, has_gauss, gauss = state["numpy"]
    torch.set_rng_state(state["torch"])
    np.random.set_state((kind, keys.numpy().astype(np.uint32), position, has_gauss, gauss))
    random.setstate(state["python"])
    if "cuda" in state and torch.cuda.is_available():
        torch.cuda.set_rng_state_all(state["cuda"])
