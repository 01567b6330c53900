"""Runs of several processes on this machine, as torchrun starts them, but from one warm server."""

import faulthandler
import multiprocessing
import os
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

import patience
from fake_rooms import FakeRooms
from instok3d.training import distributed
from instok3d.training.checkpoint import has_checkpoint
from instok3d.training.config import TrainConfig
from instok3d.training.loop import train
from instok3d.training.update import NonFiniteLossError
from toy_stage import ToyStage

ROOMS = FakeRooms(6, size=32)
SERVER = multiprocessing.get_context("forkserver")
# Only what is installed: the server does not know the folder of the tests.
SERVER.set_forkserver_preload(["instok3d.training.loop"])


def run_processes(count: int, function: Callable[..., Any], *arguments: Any) -> list[Any]:
    """What the function returned in each of `count` processes of one group."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    results = SERVER.SimpleQueue()
    processes = [
        SERVER.Process(target=_member, args=(rank, count, port, results, function, arguments))
        for rank in range(count)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(patience.SECONDS)
        if process.exitcode is None:
            running = [other for other in processes if other.exitcode is None]
            for other in running:
                os.kill(other.pid, signal.SIGUSR1)  # writes where it hangs
            for other in running:
                other.join(patience.SECONDS / 100)
                other.kill()
            raise TimeoutError(f"a process of {function.__name__} hangs")
        assert process.exitcode == 0
    return [value for _, value in sorted(results.get() for _ in processes)]


def _member(rank, count, port, results, function, arguments) -> None:
    faulthandler.register(signal.SIGUSR1, file=sys.__stderr__, all_threads=True)
    about = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": count, "MASTER_PORT": port}
    os.environ.update({name: str(value) for name, value in about.items()})
    os.environ["MASTER_ADDR"] = "127.0.0.1"
    torch.set_num_threads(1)
    results.put((rank, function(*arguments)))


def train_toy(config: TrainConfig, folder: Path, dropout: float, resume: bool = False) -> str:
    return train(config, ToyStage(dropout=dropout), ROOMS, folder, resume=resume).reason


def train_run(config: TrainConfig, folder: Path) -> str:
    distributed.MIN_UNIT_PARAMETERS = 1000  # so that small blocks are gathered one at a time too
    return train(config, config.stage.build(), ROOMS, folder).reason


def train_toy_with_one_bad_process(config: TrainConfig, folder: Path) -> str:
    stage = ToyStage(bad_step=2 if os.environ["RANK"] == "1" else None)
    try:
        train(config, stage, ROOMS, folder)
    except NonFiniteLossError as error:
        return str(error)
    return "went on"


def train_toy_with_one_stopped_process(config: TrainConfig, folder: Path) -> tuple[int, str]:
    class Stopped(ToyStage):
        def loss(self, model, sample, step):
            if step == 2 and os.environ["RANK"] == "1":
                os.kill(os.getpid(), signal.SIGTERM)
            return super().loss(model, sample, step)

    outcome = train(config, Stopped(), ROOMS, folder)
    return outcome.step, outcome.reason


def train_toy_until_killed(
    config: TrainConfig, folder: Path, strike: tuple[str, int] | None
) -> None:
    """Train from the newest checkpoint, if any; die at the n-th operation of a kind, if asked to.

    write: when half of a file of tensors is written; open and rename: before a file of the run is
    opened or takes its name; call: a call, a return or an exception of Python's, after the first
    checkpoint.
    """
    torch.set_num_threads(1)
    if strike is not None:
        _die_at(folder, *strike)
    train_toy(config, folder, 0.5, resume=has_checkpoint(folder))


def _die_at(folder: Path, kind: str, number: int) -> None:
    left = [number]

    def count() -> bool:
        left[0] -= 1
        return left[0] == 0

    def watch(event: str, arguments: tuple) -> None:
        ours = event in (kind, f"os.{kind}") and str(arguments[0]).startswith(str(folder))
        if ours and count():
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "call" and event == "os.rename" and "step_" in os.fsdecode(arguments[1]):
            sys.setprofile(watch_calls)

    def watch_calls(*_: object) -> None:
        if count():
            os.kill(os.getpid(), signal.SIGKILL)

    def torn_save(content: Any, path: Path) -> None:
        save(content, path)
        if kind == "write" and count():
            os.truncate(path, path.stat().st_size // 2)
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    save, torch.save = torch.save, torn_save
