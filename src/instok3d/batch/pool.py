"""Jobs spread over processes of this machine; one that dies takes its own job and no other."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context

from instok3d.batch.executor import Answer, Job, Outcome, ProcessDiedError


@dataclass(frozen=True)
class Processes:
    """An executor of this machine. One process is this one, more are fresh ones."""

    workers: int = 1

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise ValueError(f"workers must be 1 or more, got {self.workers}")

    @property
    def threads(self) -> int:
        """An even share of the cores."""
        return max(1, (os.cpu_count() or 1) // self.workers)

    def run(
        self, function: Callable[[Job], Answer], jobs: Sequence[Job]
    ) -> Iterator[Outcome[Job, Answer]]:
        """The outcomes of jobs as they come.

        A job whose process died is run again, alone, since it cannot be told from those beside it.
        """
        workers = min(self.workers, len(jobs))
        if workers <= 1:
            for job in jobs:
                try:
                    yield Outcome(job, function(job), None)
                except Exception as error:
                    yield Outcome(job, None, error)
            return
        again: list[Job] = []
        yield from _spread(function, jobs, workers, again)
        for job in again:
            dead: list[Job] = []
            yield from _spread(function, [job], 1, dead)
            if dead:
                yield Outcome(job, None, ProcessDiedError())


def _spread(
    function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int, dead: list[Job]
) -> Iterator[Outcome[Job, Answer]]:
    """The outcomes of jobs; those that were at work when a process died are put aside."""
    waiting = list(reversed(jobs))
    while waiting:
        with ProcessPoolExecutor(workers, get_context("spawn"), _begin_worker) as pool:
            running: dict[Future[Answer], Job] = {}
            broken = False
            try:
                while (waiting and not broken) or running:
                    while waiting and not broken and len(running) < workers:
                        job = waiting.pop()
                        try:
                            running[pool.submit(function, job)] = job
                        except BrokenProcessPool:
                            waiting.append(job)
                            broken = True
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        job = running.pop(future)
                        error = future.exception()
                        if isinstance(error, BrokenProcessPool):
                            broken = True
                            dead.append(job)
                        elif isinstance(error, Exception):
                            yield Outcome(job, None, error)
                        elif error is not None:
                            raise error
                        else:
                            yield Outcome(job, future.result(), None)
            except BaseException:  # such as Ctrl-C: what runs is not waited for
                for process in list((pool._processes or {}).values()):
                    process.terminate()
                pool.shutdown(wait=False, cancel_futures=True)
                raise


def _begin_worker() -> None:
    """Ctrl-C and a closed terminal reach all; the main process then ends the others by SIGTERM."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
