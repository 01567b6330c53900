"""One update of the weights, and what keeps a bad one from being made."""

from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import torch
from torch import nn
from torch.distributed.tensor import DTensor

from instok3d.data.sample import Sample, collate
from instok3d.files import replacing
from instok3d.training.checkpoint import RunState, WeightAverage
from instok3d.training.config import TrainConfig
from instok3d.training.distributed import ALONE, Processes, clip_gradients, gradients_shared
from instok3d.training.run_log import RunningMeans, format_figures
from instok3d.training.stages.stage import StepLoss


class NonFiniteLossError(ValueError):
    """The loss or the gradient is not finite; the update was not made and the batch is saved."""


def new_state(config: TrainConfig, model: nn.Module) -> RunState:
    """Optimizer and average of a model before the first step; sharded if the model is."""
    trained = [p for p in model.parameters() if p.requires_grad]
    # One kernel for all tensors, where the default loops over a few hundred. It takes no mixture
    # of sharded tensors and scalars, which have no shards.
    mixed = len({isinstance(p, DTensor) for p in trained}) > 1
    optimizer = torch.optim.AdamW(
        parameter_groups(
            model,
            config.weight_decay,
            backbone_lr_factor=config.backbone_lr_factor,
            backbone_weight_decay=config.backbone_weight_decay,
        ),
        lr=config.lr,
        betas=config.betas,
        **({"foreach": False} if mixed else {"fused": True}),
    )
    return RunState(model, optimizer, WeightAverage(model, config.ema_decay))


def parameter_groups(
    model: nn.Module,
    weight_decay: float,
    *,
    backbone_lr_factor: float = 1.0,
    backbone_weight_decay: float | None = None,
) -> list[dict]:
    """Trained parameters in two groups: decayed weights of linear maps, and all others.

    Pretrained parameters of the model's backbone make two more where they learn otherwise. Its
    layer for intrinsics is new, so it counts with the rest.
    """
    linear = (nn.Linear, nn.modules.conv._ConvNd)
    decayed = {id(m.weight) for m in model.modules() if isinstance(m, linear)}
    apart = backbone_lr_factor != 1.0 or backbone_weight_decay is not None
    of_backbone, others = [], []
    for name, parameter in model.named_parameters():
        pretrained = apart and name.startswith("backbone.") and "intrinsics" not in name
        if parameter.requires_grad:
            (of_backbone if pretrained else others).append(parameter)
    backbone_decay = weight_decay if backbone_weight_decay is None else backbone_weight_decay
    groups = []
    for part, decay, factor in (
        (others, weight_decay, 1.0),
        (of_backbone, backbone_decay, backbone_lr_factor),
    ):
        if part is others or part:
            weights = [p for p in part if id(p) in decayed]
            rest = [p for p in part if id(p) not in decayed]
            groups.append({"params": weights, "weight_decay": decay, "lr_factor": factor})
            groups.append({"params": rest, "weight_decay": 0.0, "lr_factor": factor})
    return groups


def train_step(
    config: TrainConfig,
    loss_of: nn.Module,
    state: RunState,
    parts: Sequence[Sample],
    rate: float,
    folder: Path,
    processes: Processes = ALONE,
) -> dict[str, float]:
    """One update; the mean figures of this process's parts of the batch.

    The gradient is the mean over all parts of all processes. A finite loss whose gradient is not
    finite (a degenerate 3x3 SVD, say) leaves the weights as they are and is counted.

    Args:
        config: Settings of the run.
        loss_of: See `distributed.share`.
        state: Changed in place.
        parts: Batches that are seen one after the other.
        rate: Learning rate.
        folder: Where a bad batch is saved.
        processes: Those of the run; all of them take the step or none does.

    Raises:
        NonFiniteLossError: The loss is not finite in some process, or too many gradients in a
            row were not.
    """
    model, optimizer = state.model, state.optimizer
    device = processes.device(config.device)
    model.train()
    optimizer.zero_grad(set_to_none=True)
    sums = RunningMeans()
    for number, part in enumerate(parts):
        sample = part.to(device)
        with gradients_shared(loss_of, number == len(parts) - 1):
            with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=config.amp):
                loss = StepLoss(*loss_of(sample, state.step))
            bad = not loss.total.isfinite()
            if processes.any(bad)[0]:
                _stop(state, part if bad else None, folder, _figures(loss), processes)
            (loss.total / len(parts)).backward()
        sums.add(_figures(loss))
    figures = sums.take()
    trained = [p for p in model.parameters() if p.requires_grad]
    norm = clip_gradients(trained, config.clip_norm, processes)
    if not norm.isfinite():
        state.skipped += 1
        state.skipped_in_a_row += 1
        if state.skipped_in_a_row >= config.max_skipped_in_a_row:
            _stop(state, collate(parts), folder, figures, processes)
        return figures | {"skipped": float(state.skipped)}
    for group in optimizer.param_groups:
        group["lr"] = rate * group.get("lr_factor", 1.0)  # older checkpoints have no factor
    optimizer.step()
    state.average.update(model, state.step)
    state.skipped_in_a_row = 0
    figures["grad_norm"] = norm.item()
    return figures | ({"skipped": float(state.skipped)} if state.skipped else {})


def _figures(loss: StepLoss) -> dict[str, float]:
    return {"loss": loss.total.item(), **{name: v.item() for name, v in loss.terms.items()}}


def _stop(
    state: RunState,
    bad: Sample | None,
    folder: Path,
    figures: dict[str, float],
    processes: Processes,
) -> NoReturn:
    """Save what is bad in this process, if it is, and raise the same error in all processes."""
    message = None
    if bad is not None:
        process = f"_process{processes.rank}" if processes.count > 1 else ""
        path = folder / f"bad_batch_{state.step:08d}{process}.pt"
        _save_batch(path, state.step, bad)
        message = (
            f"the loss or its gradient is not finite at step {state.step} "
            f"({format_figures(figures)}); the update was not made, the batch is in {path}"
        )
    raise NonFiniteLossError("; ".join(each for each in processes.gather(message) if each))


def _save_batch(path: Path, step: int, sample: Sample) -> None:
    views = {"context": vars(sample.context), "target": vars(sample.target)}
    ids = {"context": sample.context_instances, "target": sample.target_instances}
    with replacing(path) as part:
        torch.save({"step": step, "names": list(sample.names), "instances": ids, **views}, part)
