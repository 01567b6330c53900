"""A batch from its folder of photos to its folder of scenes; run again, it goes on."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from instok3d.batch.executor import Executor, Outcome
from instok3d.batch.pool import Processes
from instok3d.batch.record import DONE, FAILED, SceneResult, read_results, write_results
from instok3d.batch.scenes import (
    ENDING,
    MadeScene,
    Options,
    SceneJob,
    find_scenes,
    fingerprint,
    make_scene,
)
from instok3d.batch.summary import write_summary
from instok3d.hub.references import is_hub
from instok3d.locking import alone_in, remove_leftovers
from instok3d.progress import progress_bar


@dataclass(frozen=True)
class Batch:
    """What a run has made of a folder."""

    results: Mapping[str, SceneResult]
    """Of every scene that is in the folder of photos now."""
    made: int
    """Scenes of this run; the others were there."""
    not_kept: tuple[str, ...]
    """Scenes that are there and that `keep` refused."""

    @property
    def failed(self) -> dict[str, SceneResult]:
        """Scenes that could not be made."""
        return {name: each for name, each in self.results.items() if each.state == FAILED}


def run_batch(
    photos: Path,
    output: Path,
    options: Options,
    *,
    executor: Executor | None = None,
    keep: Callable[[Path, bool], None] | None = None,
    say: Callable[[str], None] = print,
) -> Batch:
    """Make a scene of every subfolder of photos and of every video.

    Scenes that are there stay, unless their photos were changed since; those that failed are tried
    again. What went wrong with one scene is said and recorded, and ends nothing.

    Args:
        photos: A folder of folders.
        output: Folder for NAME.itk, batch.json and contact_sheet.jpg; made if it is not there.
        options: For all scenes.
        executor: Where scenes are made; None makes them in this process. Its machines see the
            folders and the model at the same places.
        keep: Called with the place of each scene that is there, and whether this run made it.
        say: Takes a line for each scene that failed, and for each that `keep` refused.

    Raises:
        FileNotFoundError: There is no such folder, or no such model.
        ValueError: It holds no scene, the output is of another batch, or another run writes there.
    """
    executor = executor or Processes()
    if not (options.model is None or is_hub(options.model) or options.model.is_file()):
        raise FileNotFoundError(f"there is no model {options.model}")
    scenes = find_scenes(photos)
    record = options.record()
    known = read_results(output, record)
    output.mkdir(parents=True, exist_ok=True)
    refusal = f"another run is making scenes in {output}: wait for its end"
    with alone_in(output / "lock", refusal):
        remove_leftovers(output)
        prints = {name: fingerprint(place) for name, place in scenes.items()}
        results = {
            name: known[name]
            for name in scenes
            if name in known and _is_there(known[name], output / f"{name}{ENDING}", prints[name])
        }
        jobs = [
            SceneJob(name, place, output / f"{name}{ENDING}", options, executor.threads)
            for name, place in scenes.items()
            if name not in results
        ]
        begun, not_kept = len(results), []

        def kept(name: str, *, made: bool) -> None:
            try:
                if keep is not None:
                    keep(output / f"{name}{ENDING}", made)
            except (ValueError, KeyError, OSError) as error:
                not_kept.append(name)
                say(f"{name}: made, but {_words(error)}")

        for name in list(results):
            kept(name, made=False)
        with progress_bar(len(scenes), unit="scene", done=begun) as bar:
            for outcome in executor.run(timed_scene, jobs):
                name = outcome.job.name
                results[name] = _result(outcome, prints[name])
                write_results(output, record, results)
                if outcome.answer is None:
                    say(f"{name}: {results[name].error}")
                else:
                    kept(name, made=True)
                bar.update()
        remove_leftovers(output)  # of processes that were killed
        write_results(output, record, results)
        write_summary(output, [n for n in scenes if results[n].state == DONE], ENDING)
    return Batch({name: results[name] for name in scenes}, len(results) - begun, tuple(not_kept))


def timed_scene(job: SceneJob) -> tuple[MadeScene, float]:
    """Make one scene; what came out, and the seconds it took."""
    begin = time.monotonic()
    return make_scene(job), time.monotonic() - begin


def _is_there(result: SceneResult, place: Path, photos: str) -> bool:
    return result.state == DONE and result.fingerprint == photos and place.is_dir()


def _result(outcome: Outcome[SceneJob, tuple[MadeScene, float]], photos: str) -> SceneResult:
    job = outcome.job
    base = partial(SceneResult, photos=str(job.photos), fingerprint=photos)
    if outcome.answer is None:
        assert outcome.error is not None
        return base(state=FAILED, seconds=0.0, error=_words(outcome.error))
    made, seconds = outcome.answer
    return base(state=DONE, seconds=seconds, objects=made.objects, gaussians=made.gaussians)


def _words(error: Exception) -> str:
    """What an error says, in one line."""
    said = error.args[0] if isinstance(error, KeyError) and error.args else error
    return " ".join(str(said).split())[:1000] or type(error).__name__
