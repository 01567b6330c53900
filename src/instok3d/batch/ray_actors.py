"""Jobs spread over the machines of a Ray cluster; a job whose actor dies goes to another one."""

import logging
import os
import re
import signal
import socket
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from importlib import import_module
from typing import Any

from instok3d.batch.executor import Answer, Job, Outcome, ProcessDiedError

LOCAL, AUTO = "local", "auto"
ADDRESS = re.compile(r"(?P<host>[^\s:/]+):(?P<port>\d{1,5})")
PATIENCE_S = 10.0
"""For a connection to the address of a cluster."""
TRIES = 3
"""Actors in a row that may die before they begin."""
DEATHS = 2
"""Of the actors of one job, until it is given up."""
STORE_BYTES = 128 * 1024**2
"""Of a local Ray's store of objects: jobs and answers are a few hundred bytes each."""


class RayActors:
    """An executor of a Ray cluster: each worker is an actor, a process that lasts.

    Jobs go to actors that have begun, so that those for which there is no room hold nothing up.
    """

    def __init__(self, ray: Any, workers: int, threads: int, gpus: int) -> None:
        """Use the cluster that this process is connected to; see `ray_actors`."""
        self._ray, self.workers, self._gpus = ray, workers, gpus
        self._threads = threads
        known = ray.exceptions
        self._deadly = (known.RayActorError, known.WorkerCrashedError, known.NodeDiedError,
                        known.OutOfMemoryError)  # fmt: skip

    @property
    def threads(self) -> int:
        """Processors that each actor has reserved."""
        return self._threads

    def run(
        self, function: Callable[[Job], Answer], jobs: Sequence[Job]
    ) -> Iterator[Outcome[Job, Answer]]:
        """The outcomes of jobs as they come.

        Raises:
            ValueError: No actor can begin, as where this package is not installed.
        """
        waiting = list(reversed(range(len(jobs))))
        beginning: dict[Any, Any] = {}  # what tells that an actor has begun, and the actor
        running: dict[Any, tuple[Any, int]] = {}  # what becomes an answer, its actor and its job
        deaths: Counter[int] = Counter()
        tries = 0
        try:
            while waiting or running:
                wanted = min(self.workers, len(waiting) + len(running))
                while len(beginning) + len(running) < wanted:
                    actor = self._actor()
                    beginning[actor.begin.remote()] = actor
                (ready,), _ = self._ray.wait([*beginning, *running], num_returns=1)
                if ready in beginning:
                    actor, error = beginning.pop(ready), self._answer(ready)[1]
                    tries = 0 if error is None else tries + 1
                    if error is not None and tries == TRIES:
                        raise _cannot_begin(error)
                else:
                    actor, place = running.pop(ready)
                    answer, error = self._answer(ready)
                    died = isinstance(error, self._deadly)
                    deaths[place] += died
                    if not died:
                        yield Outcome(jobs[place], answer, error)
                        error = None
                    elif deaths[place] == DEATHS:
                        yield Outcome(jobs[place], None, ProcessDiedError())
                    else:
                        waiting.append(place)
                if error is None and waiting:
                    place = waiting.pop()
                    running[actor.run.remote(function, jobs[place])] = actor, place
                else:
                    self._ray.kill(actor)
        finally:
            for actor in [*beginning.values(), *(actor for actor, _ in running.values())]:
                self._ray.kill(actor)

    def _actor(self) -> Any:
        # Ray would start dead actors and their jobs again by itself, without end for some.
        kind = self._ray.remote(_Worker)
        return kind.options(
            num_cpus=self._threads, num_gpus=self._gpus, max_restarts=0, max_task_retries=0
        ).remote()

    def _answer(self, ready: Any) -> tuple[Any, Exception | None]:
        """What came out, or the error as the function raised it."""
        try:
            return self._ray.get(ready), None
        except self._ray.exceptions.RayTaskError as error:
            cause = error.cause
            return None, cause if isinstance(cause, Exception) else error
        except self._ray.exceptions.RayError as error:
            return None, error


class _Worker:
    """The actor."""

    def begin(self) -> None:
        """Returns once the process is there."""
        os.environ.setdefault("OMP_WAIT_POLICY", "passive")

    def run(self, function: Callable[[Any], Any], job: Any) -> Any:
        return function(job)


@contextmanager
def ray_actors(
    address: str, workers: int | None = None, *, needs_gpu: bool = False
) -> Iterator[RayActors]:
    """The executor of a Ray cluster, connected during the block; what Ray prints goes to stderr.

    Args:
        address: HOST:PORT of the cluster's head; `auto` for the one that this machine belongs to;
            `local` starts one on this machine, which ends with the block.
        workers: Actors; None takes one for each machine.
        needs_gpu: Give each actor a GPU of its own.

    Raises:
        ModuleNotFoundError: Ray is not installed; says how to install it.
        ConnectionError: No cluster answers at the address.
        ValueError: The address is none, or the cluster has no room for so many workers.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be 1 or more, got {workers}")
    _check_address(address)
    ray = _ray()
    with redirect_stdout(sys.stderr):  # Ray writes there, also from threads, that a worker died
        _connect(ray, address, workers)
        try:
            machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
            count = workers or len(machines)
            gpus = int(sum(each.get("GPU", 0) for each in machines))
            if needs_gpu and count > gpus:
                raise ValueError(f"the Ray cluster has {gpus} GPUs: give at most so many --workers")
            threads = shared_processors([int(each.get("CPU", 0)) for each in machines], count)
            yield RayActors(ray, count, threads, int(needs_gpu))
        finally:
            ray.shutdown()


def shared_processors(machines: Sequence[int], workers: int) -> int:
    """The most processors that each worker can have when all have as many and none is split.

    Args:
        machines: Processors of each.
        workers: How many are to find a place.

    Raises:
        ValueError: There are fewer processors than workers.
    """
    if workers > sum(machines):
        raise ValueError(
            f"the Ray cluster has {sum(machines)} processors, too few for {workers} workers: give "
            "fewer --workers"
        )
    fits = range(max(machines), 0, -1)
    return next(each for each in fits if sum(own // each for own in machines) >= workers)


def _ray() -> Any:
    try:
        return import_module("ray")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"--ray needs the package {error.name}: pip install 'instok3d[ray]', here and on the "
            "machines of the cluster"
        ) from error


def _check_address(address: str) -> None:
    """Fail at once where Ray would try for minutes."""
    if address in (LOCAL, AUTO):
        return
    found = ADDRESS.fullmatch(address)
    if found is None or not 0 < int(found["port"]) < 65536:
        raise ValueError(f"--ray takes HOST:PORT, {AUTO} or {LOCAL}, got {address!r}")
    try:
        socket.create_connection((found["host"], int(found["port"])), PATIENCE_S).close()
    except OSError as error:
        raise ConnectionError(
            f"no Ray cluster answers at {address} ({error.strerror or error}): start one there "
            f"with `ray start --head`, or give --ray {LOCAL}"
        ) from error


def _connect(ray: Any, address: str, workers: int | None) -> None:
    """Connect, without Ray's own log and its handler of SIGTERM."""
    own: dict[str, Any] = {}
    if address == LOCAL:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        own = {"num_cpus": max(workers or 1, os.cpu_count() or 1), "include_dashboard": False,
               "object_store_memory": STORE_BYTES}  # fmt: skip
    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL, **own)
    except Exception as error:  # of a node that does not start in time there is no narrower one
        words = " ".join(str(error).split())[:300]
        raise ConnectionError(
            f"cannot work with the Ray cluster {address}: {words or type(error).__name__}"
        ) from error
    finally:
        if main:
            signal.signal(signal.SIGTERM, before)


def _cannot_begin(error: Exception) -> ValueError:
    last = [line.strip() for line in str(error).splitlines() if line.strip()][-1:]
    return ValueError(
        f"the Ray cluster starts no worker ({' '.join(last)[:300]}): is the same instok3d "
        "installed on its machines?"
    )
