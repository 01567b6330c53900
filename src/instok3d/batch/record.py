"""What a batch has made so far: batch.json in its folder."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from instok3d.files import write_json
from instok3d.reading import naming_damage, number, one_of, read_json, text, whole_number

NAME = "batch.json"
REMEDY = "delete it; all scenes are then made anew"
DONE, FAILED = "done", "failed"


@dataclass(frozen=True)
class SceneResult:
    """What became of one scene."""

    state: str
    """DONE or FAILED."""
    photos: str
    """Their place."""
    fingerprint: str
    """Of the photos that it was made of."""
    seconds: float
    objects: int = 0
    gaussians: int = 0
    error: str | None = None


def read_results(folder: Path, options: Mapping[str, Any]) -> dict[str, SceneResult]:
    """The results in a folder; none where nothing was made yet.

    Raises:
        ValueError: They are damaged, or were made with other options.
    """
    path = folder / NAME
    if not path.is_file():
        return {}
    value = read_json(path, REMEDY)
    with naming_damage(path, REMEDY):
        there = dict(value["options"])
        if there != dict(options):
            other = sorted(key for key in {*there, *options} if there.get(key) != options.get(key))
            raise ValueError(
                f"{path} is of scenes made with another {', '.join(other)}: give the same, or "
                "another output folder"
            )
        return {name: _result(each) for name, each in dict(value["scenes"]).items()}


def write_results(
    folder: Path, options: Mapping[str, Any], results: Mapping[str, SceneResult]
) -> None:
    """Write the results, whole."""
    done = [each for each in results.values() if each.state == DONE]
    write_json(
        folder / NAME,
        {
            "options": dict(options),
            "done": len(done),
            "failed": len(results) - len(done),
            "objects": sum(each.objects for each in done),
            "scenes": {name: asdict(each) for name, each in sorted(results.items())},
        },
    )


def _result(value: Any) -> SceneResult:
    error = value["error"]
    return SceneResult(
        state=one_of(value["state"], (DONE, FAILED)),
        photos=text(value["photos"]),
        fingerprint=text(value["fingerprint"]),
        seconds=number(value["seconds"]),
        objects=whole_number(value["objects"]),
        gaussians=whole_number(value["gaussians"]),
        error=None if error is None else text(error),
    )
