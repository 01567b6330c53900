"""The paper's presets at full size with random weights: time and memory of forward and update."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from gpu_parts.measuring import against_lower_bound, peak_bytes, seconds_of, synchronize
from gpu_parts.rows import Row, Setting
from instok3d.backbones.cost import Work
from instok3d.backbones.registry import build_backbone
from instok3d.backbones.vggt import PAPER_VGGT, VGGTConfig
from instok3d.data.sample import Sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.memory import predict_peak_bytes
from instok3d.model.pixel_gaussians import PixelGaussianConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.objectives.lpips import Lpips
from instok3d.training.config import TrainConfig, preset
from instok3d.training.cost.estimate import (
    PEAK_TFLOPS,
    UTILISATION,
    flop_per_batch,
    samples_per_batch,
    targets_of,
    training_memory_bytes,
)
from instok3d.training.distributed import ALONE, share
from instok3d.training.stages.tokenizer import TokenizerStageConfig
from instok3d.training.update import new_state, train_step
from instok3d.types import Views
from instok3d.weights.writing import write_tensors

TOY_VGGT = VGGTConfig(
    img_size=64, patch_size=16, embed_dim=32, depth=2, num_heads=2, dino_depth=1,
    num_register_tokens=2, camera_trunk_depth=1, dpt_features=16, dpt_out_channels=(8, 8, 16, 16),
    dpt_layers=(0, 0, 1, 1), intrinsics_token=True,
)  # fmt: skip
TOY_TOKENIZER = TokenizerConfig(
    width=64, num_anchors=8, num_groups=4, anchor_layers=1, group_layers=1,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
)  # fmt: skip


def forward(setting: Setting, num_views: int) -> list[Row]:
    """VGGT on so many views under bfloat16: time, memory, and what both must be at least."""
    config = TOY_VGGT if setting.toy else PAPER_VGGT
    side = config.img_size
    torch.manual_seed(0)
    with torch.device(setting.device):
        # As in training, and FlopCounterMode fails on inputs that require gradients under no_grad.
        model = build_backbone(config).eval().requires_grad_(False)
        sample = random_sample(num_views, 1, 1, side)
    views = Views(sample.context.images, sample.context.intrinsics)

    @torch.no_grad()
    def run() -> None:
        with torch.autocast(setting.device, torch.bfloat16):
            model(views)

    with FlopCounterMode(display=False) as counter:
        run()
    seconds, memory = seconds_of(setting, run), peak_bytes(setting)
    numbers = sum(p.numel() for p in model.parameters())
    work = Work(num_views, side, side, dtype=torch.bfloat16)
    by_plan = 2.0 * numbers * num_views * (side // config.patch_size) ** 2
    return [
        _memory(setting, memory, predict_peak_bytes(config, None, work)),
        Row("operations", f"{counter.get_total_flops() / 1e12:.3g} TFLOP",
            f"{by_plan / 1e12:.3g} TFLOP by the plan"),
        *against_lower_bound(setting, seconds, counter.get_total_flops(), 4 * numbers),
    ]  # fmt: skip


def training_step(setting: Setting, name: str) -> list[Row]:
    """An update of a preset on a random batch: time and memory, beside the plan and the bound."""
    with tempfile.TemporaryDirectory() as folder:
        return _training_step(setting, name, Path(folder))


def _training_step(setting: Setting, name: str, folder: Path) -> list[Row]:
    torch.manual_seed(0)
    config = _with_lpips(_sized(preset(name), setting), folder)
    views, side = max(config.batches.views), 64 if setting.toy else PAPER_VGGT.img_size
    stage = config.stage.build()
    with torch.device(setting.device):
        model = stage.build_model()
        sample = random_sample(
            views, targets_of(config, views), samples_per_batch(config, views), side
        )
    state, loss = new_state(config, model), share(stage, model, ALONE, "auto")
    figures: dict[str, float] = {}

    def run() -> None:
        figures.update(train_step(config, loss, state, [sample], config.lr, folder))
        state.step += 1

    run()  # the optimizer makes its moments
    with FlopCounterMode(display=False) as counter:
        run()
    seconds, memory = seconds_of(setting, run, repeats=3), peak_bytes(setting)
    synchronize(setting)
    return [
        Row("loss", f"{figures['loss']:.4g}", "finite", math.isfinite(figures["loss"])),
        _memory(setting, memory, training_memory_bytes(config, model, side, side)),
        _planned(setting, seconds, flop_per_batch(config, model, side, side)),
        *against_lower_bound(setting, seconds, counter.get_total_flops(), _least_bytes(model)),
    ]  # fmt: skip


def _memory(setting: Setting, measured: int, predicted: int) -> Row:
    good = measured <= predicted if setting.on_gpu else None
    bound = f"{predicted / 1e9:.2f} GB"
    expected = f"<= {bound}" if setting.on_gpu else f"{bound} is the estimate for a GPU"
    return Row("peak memory", f"{measured / 1e9:.2f} GB", expected, good)


def _planned(setting: Setting, seconds: float, flop: float) -> Row:
    """Time of an update beside that of --dry-run, which is right within a factor of two.

    That of the plan holds reading and validation too, so that an update alone may be quicker.
    """
    name = torch.cuda.get_device_name().lower().replace(" ", "") if setting.on_gpu else ""
    peak = next((rate for gpu, rate in PEAK_TFLOPS.items() if gpu in name), None)
    if peak is None:
        return Row(
            "time against the plan", f"{1e3 * seconds:.1f} ms", "the peak of this device is unknown"
        )
    plan_s = flop / (peak * 1e12 * UTILISATION)
    return Row("time against the plan", f"{1e3 * seconds:.1f} ms",
               f"<= 2 x {1e3 * plan_s:.1f} ms", seconds <= 2 * plan_s)  # fmt: skip


def _least_bytes(model: nn.Module) -> float:
    """Weights once; those that learn eight times more.

    Those are for the gradient, its way out and in, both moments in and out, the weights out.
    """
    numbers = [(p.numel(), p.requires_grad) for p in model.parameters()]
    return 4.0 * sum(size * (9 if learns else 1) for size, learns in numbers)


def _sized(config: TrainConfig, setting: Setting) -> TrainConfig:
    config = replace(config, device=setting.device)
    if not setting.toy:
        return config
    stage = replace(config.stage, backbone=TOY_VGGT)
    if isinstance(stage, TokenizerStageConfig):
        stage = replace(stage, tokenizer=TOY_TOKENIZER)
    else:
        stage = replace(stage, head=PixelGaussianConfig(width=8))
    return replace(config, stage=stage, batches=replace(config.batches, batch_size=1))


def _with_lpips(config: TrainConfig, folder: Path) -> TrainConfig:
    """LPIPS with random weights: it costs what the real one does."""
    file = folder / "lpips.safetensors"
    write_tensors(file, Lpips("vgg16").state_dict(), {"lpips_trunk": "vgg16"})
    return replace(config, stage=replace(config.stage, lpips_file=file))


def random_sample(views: int, targets: int, batch: int, side: int) -> Sample:
    """A batch of pictures of noise with four instances, two metres away, on the default device.

    Frames follow one another along a line; targets lie between the context views, equally many
    in each gap up to one.
    """
    step = 1 + math.ceil(targets / max(1, views - 1))
    shown = range(0, step * views, step)
    between = sorted(
        set(range(step * (views - 1))) - set(shown), key=lambda frame: (frame % step, frame)
    )
    frames = FrameChoice(tuple(shown), tuple(sorted(between[:targets])))
    rows = torch.arange(side) * 2 // side
    ids = (1 + rows[:, None] + 2 * rows[None]).expand(batch, 1, side, side)
    return Sample(
        context=_random_views(frames.context, batch, side),
        target=_random_views(frames.target, batch, side),
        context_instances=ids.expand(batch, views, side, side).clone(),
        target_instances=ids.expand(batch, targets, side, side).clone(),
        names=tuple(f"random {number}" for number in range(batch)),
        frames=(frames,) * batch,
    )


def _random_views(frames: tuple[int, ...], batch: int, side: int) -> Views:
    count = len(frames)
    cam_from_world = torch.eye(4).expand(batch, count, 4, 4).clone()
    cam_from_world[:, :, 0, 3] = 0.05 * torch.tensor(frames)
    intrinsics = torch.tensor([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    return Views(
        images=torch.rand(batch, count, 3, side, side),
        intrinsics=intrinsics.expand(batch, count, 3, 3).clone(),
        cam_from_world=cam_from_world,
        depths=torch.full((batch, count, side, side), 2.0),
    )
