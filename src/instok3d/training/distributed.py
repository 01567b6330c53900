"""One run on several processes: what all of them agree on, and how they share a model.

torchrun starts the processes and tells each its place in the environment. DDP keeps the whole
model in every process, FSDP2 a part of each parameter. Decisions travel over gloo on the CPU, so
they cost no synchronisation of a GPU; gradients over nccl on CUDA.
"""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, distributed, nn
from torch.distributed.device_mesh import init_device_mesh
from torch.distributed.fsdp import FSDPModule, fully_shard
from torch.distributed.tensor import DTensor, distribute_tensor
from torch.nn.parallel import DistributedDataParallel

from instok3d.data.sample import Sample
from instok3d.training.stages.stage import Stage

Strategy = Literal["auto", "single", "ddp", "fsdp"]

MIN_UNIT_PARAMETERS = 1_000_000
"""Blocks with at least so many parameters are gathered one at a time by FSDP."""
WAIT = timedelta(hours=2)
"""The others wait so long while the first process validates or writes."""
SECONDS_TO_LET_GO = 0.3
"""A busy machine runs every waiting thread within so long."""


@dataclass(frozen=True)
class Processes:
    """This process among those of the run; alone by default."""

    rank: int = 0
    count: int = 1
    local_rank: int = 0
    """Among the processes of this machine: which GPU it takes."""

    @property
    def is_first(self) -> bool:
        """Whether this one writes logs, pictures and checkpoints."""
        return self.rank == 0

    def device(self, kind: str) -> str:
        """This process's device; "cuda" becomes one GPU for each process of a machine."""
        return f"cuda:{self.local_rank}" if kind == "cuda" and self.count > 1 else kind

    def any(self, *flags: bool) -> list[bool]:
        """For each flag, whether it is set in any process; the same answer in all of them."""
        if self.count == 1:
            return list(flags)
        values = torch.tensor(flags, dtype=torch.int32)
        distributed.all_reduce(values, distributed.ReduceOp.MAX)
        return [bool(value) for value in values]

    def gather(self, value: Any) -> list[Any]:
        """The values of all processes in their order, in each of them."""
        if self.count == 1:
            return [value]
        values: list[Any] = [None] * self.count
        distributed.all_gather_object(values, value)
        return values


ALONE = Processes()


def check_device(device: str) -> None:
    """Fail early where the device is a GPU and there is none.

    Raises:
        ValueError: So it is; says what to do.
    """
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise ValueError(
            f"--device {device}: torch sees no CUDA device here; give --device cpu, or install "
            "the build of torch with CUDA"
        )


@contextmanager
def joined_processes(device: str) -> Iterator[Processes]:
    """The processes that torchrun started, or this one alone where it did not.

    Raises:
        ValueError: More processes on this machine than it has GPUs, or one GPU for them all.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield ALONE
        return
    processes = Processes(int(os.environ["RANK"]), count, int(os.environ["LOCAL_RANK"]))
    on_gpu = torch.device(device).type == "cuda"
    if on_gpu:
        if device != "cuda":
            raise ValueError(
                f"--device {device} is one GPU, and there are {count} processes: give --device cuda"
            )
        if processes.local_rank >= torch.cuda.device_count():
            raise ValueError(
                f"process {processes.local_rank} of this machine has no GPU of its own, there are "
                f"{torch.cuda.device_count()}: lower --nproc-per-node"
            )
        torch.cuda.set_device(processes.local_rank)
    distributed.init_process_group("cpu:gloo,cuda:nccl" if on_gpu else "gloo", timeout=WAIT)
    yield processes
    # Only after a run that ended well: after an error the others may be waiting in a collective,
    # and torchrun ends them once this process is gone.
    # A thread of gloo lets go of the last collective's tensors under Python's lock. This thread
    # frees the group with the lock held and waits for that one: for ever, if it is not done. A
    # barrier has no tensors, and while this thread waits in it the other one gets the lock, if
    # the machine lets it run: on a busy one that takes longer than a barrier.
    distributed.barrier()
    time.sleep(SECONDS_TO_LET_GO)
    distributed.destroy_process_group()


class SharedLoss(nn.Module):
    """A stage's loss as the forward pass of a module, for DDP and FSDP to wrap.

    Whatever part of the model a stage calls, it is called inside of this forward pass.
    """

    def __init__(self, stage: Stage, model: nn.Module) -> None:
        super().__init__()
        self.stage = stage
        self.model = model

    def forward(self, sample: Sample, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss as plain tensors, in which FSDP finds what backward starts from."""
        loss = self.stage.loss(self.model, sample, step)
        return loss.total, loss.terms


def share(stage: Stage, model: nn.Module, processes: Processes, strategy: Strategy) -> nn.Module:
    """The stage's loss of the model, ready for several processes.

    FSDP replaces the model's parameters by their shards; it gathers the members of ModuleLists
    that are large enough one at a time, and all else at once. Such a member must be used by calling
    it. A process that is alone shares with nobody, whatever the strategy.

    Args:
        stage: Gives the loss.
        model: On its device, with the same weights in every process.
        processes: Those of the run.
        strategy: auto = ddp.

    Raises:
        ValueError: The strategy is single and there are several processes.
    """
    loss = SharedLoss(stage, model)
    if processes.count == 1:
        return loss
    if strategy == "single":
        raise ValueError(
            f"strategy 'single' is for one process, got {processes.count}: choose ddp or fsdp"
        )
    return wrapped(loss, processes.count, "fsdp" if strategy == "fsdp" else "ddp")


def wrapped(loss: SharedLoss, count: int, strategy: Literal["ddp", "fsdp"]) -> nn.Module:
    """A loss under DDP or FSDP, for as many processes; also for one, to try them out."""
    model = loss.model
    if strategy == "ddp":
        return DistributedDataParallel(loss, find_unused_parameters=not loss.stage.learns_whole)
    mesh = init_device_mesh(next(model.parameters()).device.type, (count,))
    lists = [module for module in model.modules() if isinstance(module, nn.ModuleList)]
    units = [unit for members in lists for unit in members]
    scalars = {p for p in model.parameters() if p.ndim == 0}  # FSDP has no shards of them
    for unit in reversed(units):
        if sum(p.numel() for p in unit.parameters()) >= MIN_UNIT_PARAMETERS:
            fully_shard(unit, mesh=mesh, ignored_params=scalars)
    fully_shard(loss, mesh=mesh, ignored_params=scalars)
    return loss


@contextmanager
def gradients_shared(loss: nn.Module, now: bool) -> Iterator[None]:
    """Forward and backward passes whose gradients are averaged over the processes now or later."""
    if isinstance(loss, FSDPModule):
        loss.set_requires_gradient_sync(now)
    if isinstance(loss, DistributedDataParallel) and not now:
        with loss.no_sync():
            yield
    else:
        yield


def clip_gradients(
    parameters: Sequence[nn.Parameter], max_norm: float, processes: Processes
) -> Float[Tensor, ""]:
    """Scale the whole gradient to at most max_norm; its norm before, over all shards."""
    sharded = [p for p in parameters if isinstance(p, DTensor)]
    if not sharded:
        return nn.utils.clip_grad_norm_(parameters, max_norm)
    plain = [p for p in parameters if not isinstance(p, DTensor)]
    for parameter in plain:  # the scalars, which FSDP leaves alone
        if parameter.grad is not None:
            distributed.all_reduce(parameter.grad)
            parameter.grad /= processes.count
    kinds = [kind for kind in (sharded, plain) if any(p.grad is not None for p in kind)]
    norms = [
        nn.utils.get_total_norm([p.grad for p in kind if p.grad is not None]) for kind in kinds
    ]
    norm = torch.stack([n.full_tensor() if isinstance(n, DTensor) else n for n in norms]).norm()
    for kind in kinds:
        nn.utils.clip_grads_with_norm_(kind, max_norm, norm)
    return norm


def whole(value: Any, *, keep: bool) -> Any:
    """Nested dictionaries and lists with every shard replaced by its whole tensor on the CPU.

    All processes must ask for it at the same time. One tensor at a time is whole on the device.

    Args:
        value: Dictionaries, lists, tensors and anything else.
        keep: False in a process that only takes part: it gets empty tensors for shards.
    """
    if isinstance(value, dict):
        return {key: whole(each, keep=keep) for key, each in value.items()}
    if isinstance(value, list):
        return [whole(each, keep=keep) for each in value]
    if not isinstance(value, DTensor):
        return value
    gathered = value.full_tensor()
    return gathered.cpu() if keep else torch.empty(0)


def local(tensor: Tensor) -> Tensor:
    """This process's part of a tensor, sharing its memory."""
    return tensor.to_local() if isinstance(tensor, DTensor) else tensor


def sharded_like(tensor: Tensor, like: Tensor) -> Tensor:
    """A copy of a whole tensor on the device of another and sharded as that is."""
    if not isinstance(like, DTensor) or tensor.shape != like.shape:
        return tensor.to(like.device, copy=True)
    return distribute_tensor(
        tensor.to(like.device), like.device_mesh, like.placements, src_data_rank=None
    )
