"""DDP and FSDP2 on one device: in one process, and in two that share it, against plain training.

NCCL takes one process for each GPU, so that one process goes over NCCL and two over gloo.
"""

import copy
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, distributed, multiprocessing, nn

from gpu_parts.paper import TOY_TOKENIZER, random_sample
from gpu_parts.rows import Row, Setting, at_least, at_most
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.data.sample import Sample
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.config import TrainConfig, preset
from instok3d.training.distributed import Processes, SharedLoss, whole, wrapped
from instok3d.training.stages.tokenizer import TokenizerStageConfig
from instok3d.training.update import new_state, train_step

Kind = Literal["ddp", "fsdp"]
UPDATES = 3
BATCH = 4


def one_process(setting: Setting, kind: Kind) -> list[Row]:
    """The wrapped model of one process against the bare one."""
    return _rows(_member_in_folder(setting, kind, 0, 1))


def two_processes(setting: Setting, kind: Kind) -> list[Row]:
    """Two processes with half of the batch each against one with all of it."""
    context = multiprocessing.get_context("spawn")
    results = context.SimpleQueue()
    with tempfile.TemporaryDirectory() as folder:
        members = [
            context.Process(target=_put, args=(results, setting, kind, rank, 2, Path(folder)))
            for rank in range(2)
        ]
        for member in members:
            member.start()
        found = None
        while any(member.is_alive() for member in members):
            found = found if results.empty() else results.get()
            for member in members:
                member.join(0.05)
        found = found if results.empty() else results.get()
    codes = [member.exitcode for member in members]
    if found is None or any(codes):
        raise RuntimeError(f"the processes ended with the codes {codes}, see above")
    return _rows(found)


def _put(results: Any, *arguments: Any) -> None:
    figures = _member(*arguments)
    if figures:
        results.put(figures)


def _member_in_folder(setting: Setting, kind: Kind, rank: int, count: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        return _member(setting, kind, rank, count, Path(folder))


def _member(setting: Setting, kind: Kind, rank: int, count: int, folder: Path) -> dict[str, float]:
    """Train as a member of the group; the first one also trains alone and compares."""
    gpu_backend = "nccl" if count == 1 else "gloo"
    backend = f"cpu:gloo,cuda:{gpu_backend}" if setting.on_gpu else "gloo"
    distributed.init_process_group(
        backend, init_method=f"file://{folder}/meeting", rank=rank, world_size=count
    )
    config = _config(setting)
    stage = config.stage.build()
    torch.manual_seed(0)
    model = stage.build_model().to(setting.device)
    begun = copy.deepcopy(model)
    sample = random_sample(2, 1, BATCH, 32 if setting.toy else 128)
    processes = Processes(rank, count)
    loss = SharedLoss(stage, model)
    part = _rows_of(sample, slice(rank * BATCH // count, (rank + 1) * BATCH // count))
    shared = _train(config, wrapped(loss, count, kind), model, part, folder, processes)
    weights = whole(dict(model.state_dict()), keep=rank == 0)
    distributed.barrier()
    distributed.destroy_process_group()
    if rank:
        return {}
    plain = copy.deepcopy(begun)
    alone = _train(config, SharedLoss(stage, plain), plain, sample, folder, Processes())
    changes = [_change(begun, state) for state in (weights, plain.state_dict())]
    cosine = torch.nn.functional.cosine_similarity(*changes, dim=0)
    return {
        "loss": abs(shared["loss"] / alone["loss"] - 1),
        "gradient": abs(shared["grad_norm"] / alone["grad_norm"] - 1),
        "cosine": float(cosine),
    }


def _rows(figures: dict[str, float]) -> list[Row]:
    # Adam divides by the size of each gradient, so that rounding flips the steps of those near 0.
    return [
        at_most("relative difference of the last loss", figures["loss"], 0.05),
        at_most("relative difference of the last gradient's norm", figures["gradient"], 0.1),
        at_least(
            f"cosine between the changes of all weights over {UPDATES} updates",
            figures["cosine"],
            0.9,
        ),
    ]


def _train(
    config: TrainConfig,
    loss: nn.Module,
    model: nn.Module,
    sample: Sample,
    folder: Path,
    processes: Processes,
) -> dict[str, float]:
    state = new_state(config, model)
    figures: dict[str, float] = {}
    for step in range(UPDATES):
        state.step = step
        figures = train_step(config, loss, state, [sample], config.lr, folder, processes)
    means = processes.gather(figures["loss"])
    return figures | {"loss": sum(means) / len(means)}


def _change(begun: nn.Module, weights: dict[str, Tensor]) -> Tensor:
    pairs = [(value, weights[name]) for name, value in begun.state_dict().items()]
    return torch.cat([(b.cpu() - a.cpu()).flatten().float() for a, b in pairs])


def _rows_of(sample: Sample, rows: slice) -> Sample:
    return Sample(
        context=sample.context.map(lambda tensor: tensor[rows]),
        target=sample.target.map(lambda tensor: tensor[rows]),
        context_instances=sample.context_instances[rows],
        target_instances=sample.target_instances[rows],
        names=sample.names[rows],
        frames=sample.frames[rows],
    )


def _config(setting: Setting) -> TrainConfig:
    """The nano tokenizer on given geometry, in float32."""
    stage = TokenizerStageConfig(
        backbone=NanoConfig(width=64, layers=1) if setting.toy else NanoConfig(),
        tokenizer=TOY_TOKENIZER if setting.toy else TokenizerConfig(),
        given_probability=1.0,
        seg_weight=1.0,
        seg_warmup_steps=0,
    )
    return replace(preset("nano-tokenizer"), stage=stage, amp=False, device=setting.device, lr=1e-3)
