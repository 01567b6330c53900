"""Where the jobs of a batch run: what processes here and actors of a cluster have in common."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar, runtime_checkable

Job = TypeVar("Job")
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Outcome(Generic[Job, Answer]):
    """What became of a job."""

    job: Job
    answer: Answer | None
    error: Exception | None
    """Why there is no answer."""


class ProcessDiedError(Exception):
    """The process of a job was ended from outside, twice."""

    def __init__(self) -> None:
        super().__init__("its process was killed: too little memory?")


@runtime_checkable
class Executor(Protocol):
    """Runs jobs in processes that last from job to job."""

    @property
    def threads(self) -> int:
        """What each process has, so that all of them use every core."""
        ...

    def run(
        self, function: Callable[[Job], Answer], jobs: Sequence[Job]
    ) -> Iterator[Outcome[Job, Answer]]:
        """The outcomes of jobs as they come; their errors are among them and end nothing.

        A job whose process died is run once more; if that dies too, it is a `ProcessDiedError`.

        Args:
            function: Can be pickled.
            jobs: Each can be pickled.
        """
        ...
