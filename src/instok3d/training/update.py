"""One update of the weights, and what keeps a bad one from being made."""

from pathlib import Path

import torch
from torch import nn

from instok3d.data.sample import Sample
from instok3d.files import replacing
from instok3d.training.checkpoint import RunState, WeightAverage
from instok3d.training.config import TrainConfig
from instok3d.training.stages import Stage, StepLoss


class NonFiniteLossError(RuntimeError):
    """The loss or the gradient is not finite; the update was not made and the batch is saved."""


def new_state(config: TrainConfig, stage: Stage) -> RunState:
    """Model, optimizer and average before the first step."""
    model = stage.build_model().to(config.device)
    optimizer = torch.optim.AdamW(
        parameter_groups(model, config.weight_decay),
        lr=config.lr,
        betas=config.betas,
        fused=True,  # one kernel for all tensors; the default loops over a few hundred
    )
    return RunState(model, optimizer, WeightAverage(model, config.ema_decay))


def parameter_groups(model: nn.Module, weight_decay: float) -> list[dict]:
    """Trained parameters in two groups: decayed weights of linear maps, and all others."""
    linear = (nn.Linear, nn.modules.conv._ConvNd)
    decayed = {id(m.weight) for m in model.modules() if isinstance(m, linear)}
    trained = [p for p in model.parameters() if p.requires_grad]
    return [
        {"params": [p for p in trained if id(p) in decayed], "weight_decay": weight_decay},
        {"params": [p for p in trained if id(p) not in decayed], "weight_decay": 0.0},
    ]


def train_step(
    config: TrainConfig,
    stage: Stage,
    state: RunState,
    sample: Sample,
    rate: float,
    folder: Path,
) -> dict[str, float]:
    """One update; the figures of its batch.

    A finite loss whose gradient is not finite (a degenerate 3x3 SVD, say) leaves the weights
    as they are and is counted.

    Raises:
        NonFiniteLossError: The loss is not finite, or too many gradients in a row were not.
    """
    model, optimizer = state.model, state.optimizer
    model.train()
    with torch.autocast(sample.context.images.device.type, torch.bfloat16, enabled=config.amp):
        loss = stage.loss(model, sample, state.step)
    if not loss.total.isfinite():
        raise NonFiniteLossError(_save_bad_batch(state, sample, folder, loss))
    optimizer.zero_grad(set_to_none=True)
    loss.total.backward()
    trained = [p for p in model.parameters() if p.requires_grad]
    norm = nn.utils.clip_grad_norm_(trained, config.clip_norm)
    if norm.isfinite():
        for group in optimizer.param_groups:
            group["lr"] = rate
        optimizer.step()
        state.average.update(model, state.step)
        state.skipped_in_a_row = 0
    else:
        state.skipped += 1
        state.skipped_in_a_row += 1
        if state.skipped_in_a_row >= config.max_skipped_in_a_row:
            raise NonFiniteLossError(_save_bad_batch(state, sample, folder, loss))
    figures = {"loss": loss.total.item(), **{k: v.item() for k, v in loss.terms.items()}}
    if norm.isfinite():
        figures["grad_norm"] = norm.item()
    return figures | ({"skipped": float(state.skipped)} if state.skipped else {})


def _save_bad_batch(state: RunState, sample: Sample, folder: Path, loss: StepLoss) -> str:
    path = folder / f"bad_batch_{state.step:08d}.pt"
    views = {"context": vars(sample.context), "target": vars(sample.target)}
    ids = {"context": sample.context_instances, "target": sample.target_instances}
    content = {"step": state.step, "names": list(sample.names), "instances": ids, **views}
    with replacing(path) as part:
        torch.save(content, part)
    terms = {name: round(value.item(), 6) for name, value in loss.terms.items()}
    return (
        f"loss {loss.total.item():.4g} or its gradient is not finite at step {state.step} "
        f"(terms {terms}); the update was not made, the batch is in {path}"
    )
