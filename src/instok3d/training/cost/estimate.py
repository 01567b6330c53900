"""What a run will cost, from numbers of parameters and tokens: work, time, disk."""

from contextlib import nullcontext
from dataclasses import dataclass, replace

import torch
from torch import nn

from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.cost import Work
from instok3d.backbones.registry import kind_of
from instok3d.model.memory import PROCESS_BYTES, predict_peak_bytes, refuse_beyond
from instok3d.model.on_paper import on_paper
from instok3d.training.checkpoint import KEPT
from instok3d.training.config import TrainConfig

PEAK_TFLOPS = {
    "a6000": 155.0, "rtx4090": 165.0, "a100": 312.0, "l40s": 362.0, "h100": 989.0, "h200": 989.0,
}  # fmt: skip
"""Dense bfloat16 operations a second of a GPU, in 10^12, as its maker states them."""
UTILISATION = 0.03
"""Share of the peak that a run reaches. By the formula of `flop_per_sample` the paper's run with
two views (20 hours on 4 RTX A6000) reached 4.4 %, its run with eight (12 hours on 4 H200) 2.1 %:
rendering and reading take most of the time. Expect the double or the half of what comes out."""
LPIPS_FLOP_PER_PIXEL = 3 * 0.61e6
"""VGG16: one pass over the photo; one over the render, and one back."""


@dataclass(frozen=True)
class Part:
    """A top-level part of a model."""

    name: str
    trained: int
    """Parameters."""
    frozen: int


def model_on_paper(config: TrainConfig) -> nn.Module:
    """The run's model, without memory for its weights where it can be made so."""
    backbone = config.stage.workload().backbone
    buildable = backbone is None or kind_of(backbone).outline is None
    with on_paper() if buildable else nullcontext():
        return config.stage.new_model()


def parts_of(model: nn.Module) -> list[Part]:
    """The parts of a model with their numbers of parameters."""
    parts = []
    for name, part in model.named_children():
        counts = [0, 0]
        for parameter in part.parameters():
            counts[parameter.requires_grad] += parameter.numel()
        parts.append(Part(name, trained=counts[1], frozen=counts[0]))
    return parts


def flop_per_batch(config: TrainConfig, model: nn.Module, height: int, width: int) -> float:
    """Operations of one batch of a process, the mean over the numbers of views that it draws."""
    each = [
        samples_per_batch(config, views) * flop_per_sample(config, model, views, height, width)
        for views in config.batches.views
    ]
    return sum(each) / len(each)


def flop_per_sample(
    config: TrainConfig, model: nn.Module, views: int, height: int, width: int
) -> float:
    """Operations of one training sample of so many context views, forward and backward.

    2 for each parameter and patch of the context views, three times as much in parts that learn;
    attention between tokens, solving for cameras and rendering are left out. Parts that work by the
    pixel see pixels instead of patches, a model without a backbone sees its cells. LPIPS adds its
    share for each pixel of the targets.
    """
    work = config.stage.workload()
    backbone = next((m for m in model.modules() if isinstance(m, GeometryBackbone)), None)
    pixels = views * height * width
    patches = pixels // (work.cell_side if backbone is None else backbone.patch_size) ** 2
    total = 0.0
    for name, part in [("", model)] if backbone is model else list(model.named_children()):
        seen = pixels if name in work.pixel_parts else patches
        size = sum(p.numel() for p in part.parameters())
        learns = any(p.requires_grad for p in part.parameters())
        total += 2.0 * size * seen * (3 if learns else 1)
    if backbone is not None and not work.backbone_runs:
        total -= 2.0 * sum(p.numel() for p in backbone.parameters()) * patches
    if work.lpips:
        total += LPIPS_FLOP_PER_PIXEL * targets_of(config, views) * height * width
    return total


def samples_per_batch(config: TrainConfig, views: int) -> int:
    """Samples of so many context views that a process sees at once."""
    return max(1, config.batches.batch_size * 2 // views)


def targets_of(config: TrainConfig, views: int) -> int:
    """Target views of one sample, by the rule of the data set."""
    wanted = config.batches.num_targets * views // 2
    if config.batches.sampling == "rooms":
        return min(wanted, 2 * views - 1)
    return min(wanted, 3 if views == 2 else views - 1)


def hours(flop: float, *, num_gpus: int, gpu: str) -> float:
    """Time for so many operations: operations / (GPUs x peak x UTILISATION).

    Raises:
        ValueError: There is no such GPU in PEAK_TFLOPS.
    """
    if gpu not in PEAK_TFLOPS:
        raise ValueError(f"no peak is known of the GPU {gpu!r}; known are {sorted(PEAK_TFLOPS)}")
    if num_gpus < 1:
        raise ValueError(f"the number of GPUs must be at least 1, got {num_gpus}")
    return flop / (num_gpus * PEAK_TFLOPS[gpu] * 1e12 * UTILISATION) / 3600


def training_memory_bytes(config: TrainConfig, model: nn.Module, height: int, width: int) -> int:
    """About what one process holds at the peak of a step with most views; see `model.memory`.

    Parts that work by the pixel add input and output of each of their layers for every pixel, kept
    for the backward pass. That FSDP shares weights among processes is left out.
    """
    load, views = config.stage.workload(), max(config.batches.views)
    work = Work(
        views=views,
        height=height,
        width=width,
        dtype=torch.bfloat16 if config.amp else torch.float32,
        batch=samples_per_batch(config, views),
        training=True,
        frozen_backbone=not load.backbone_learns,
        targets=targets_of(config, views),
        lpips=load.lpips,
        cached_geometry=not load.backbone_runs,
    )
    if load.backbone is None:
        total, by_pixel = _bare_model_bytes(model), [model]
        seen = work.pixels // load.cell_side**2
    else:
        seen = work.pixels
        total = predict_peak_bytes(load.backbone, load.tokenizer, work)
        by_pixel = [model.get_submodule(name) for name in load.pixel_parts]
    channels = sum(_channels(module) for part in by_pixel for module in part.modules())
    return total + seen * channels * work.narrow


def _bare_model_bytes(model: nn.Module) -> int:
    """Process, weights, and gradient, moments and average of those that learn."""
    sizes = [(p.numel(), p.requires_grad) for p in model.parameters()]
    return PROCESS_BYTES + 4 * sum(size * (5 if learns else 1) for size, learns in sizes)


def check_memory(config: TrainConfig, height: int, width: int) -> None:
    """Refuse a run whose step is predicted not to fit, before its model is made.

    Raises:
        NotEnoughMemoryError: Says what is needed, what is there, and the batch size that fits.
    """
    model = model_on_paper(config)

    def needed(batch_size: int) -> int:
        batches = replace(config.batches, batch_size=batch_size)
        return training_memory_bytes(replace(config, batches=batches), model, height, width)

    def remedy(limit: int) -> str:
        for batch_size in range(config.batches.batch_size - 1, 0, -1):
            if needed(batch_size) <= limit:
                return f"--batches.batch-size {batch_size} would fit"
        return "not even a batch size of 1 would fit: train with fewer --batches.views"

    size = config.batches.batch_size
    views = max(config.batches.views)
    refuse_beyond(
        needed(size),
        what=f"batches of size {size} with up to {views} views of {height} x {width} pixels",
        device=config.device,
        remedy=remedy,
    )


def _channels(module: nn.Module) -> int:
    if isinstance(module, nn.Linear):
        return module.in_features + module.out_features
    if isinstance(module, nn.modules.conv._ConvNd):
        return module.in_channels + module.out_channels
    return 0


def checkpoint_bytes(model: nn.Module, *, averaged: bool = True) -> int:
    """Size of one checkpoint: weights; for trained ones two moments of Adam, and an average."""
    whole = sum(p.numel() for p in model.state_dict().values())
    trained = sum(p.numel() for p in model.parameters() if p.requires_grad)
    return 4 * (whole + (2 + averaged) * trained)


def disk_bytes(model: nn.Module, *, averaged: bool = True) -> int:
    """What the checkpoints of a run take at most: those that stay and the one being written."""
    return (KEPT + 1) * checkpoint_bytes(model, averaged=averaged)
