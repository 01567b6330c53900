"""The protocols on prepared data sets: which scenes, which frames are shown and asked for."""

import reprlib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from instok3d.data.batches import NoBaselineError, Unit, make_sample
from instok3d.data.view_sampling import (
    FrameChoice,
    eight_view_protocol,
    lsm_protocol,
    mipnerf360_protocol,
)
from instok3d.datasets.prepared import PreparedScenes
from instok3d.evaluation.protocols import ProtocolScene
from instok3d.reading import read_json, reason_of, whole_number

DatasetProtocol = Literal["scannet-2view", "scannet-8view", "re10k-2view", "mipnerf360-2view"]

DATASETS: dict[DatasetProtocol, tuple[str, ...]] = {
    "scannet-2view": ("scannet",),
    "scannet-8view": ("scannet",),
    "re10k-2view": ("re10k",),
    "mipnerf360-2view": ("mipnerf360", "colmap"),
}
"""The kinds of prepared scenes that a protocol takes."""

ChooseFrames = Callable[[PreparedScenes, int], list[FrameChoice]]
"""All samples of a scene; none where the protocol leaves the scene out."""


def frame_chooser(
    protocol: DatasetProtocol,
    *,
    re10k_index: Mapping[str, Any] | None = None,
    all_targets: bool = False,
) -> ChooseFrames:
    """How a protocol chooses the frames of a scene.

    scannet-2view (LSM): targets i with i mod 8 in {1, 4}, contexts i-1 and i+1. scannet-8view
    (Uni3R): of the first 15 frames the even ones are contexts, the odd ones targets. re10k-2view
    (pixelSplat): contexts and targets by the index. mipnerf360-2view (Uni3R): i mod 8 in {2, 6},
    contexts i-2 and i+2.

    Args:
        protocol: Which.
        re10k_index: Scene to {"context": [a, b], "target": [...]} in frames of the clip, or to
            None where the scene is left out.
        all_targets: mipnerf360-2view alone: all samples instead of the one in the middle, which
            the paper's "one target" is taken for.

    Raises:
        ValueError: re10k-2view without an index.
    """
    if protocol == "re10k-2view":
        if re10k_index is None:
            raise ValueError(
                "re10k-2view needs the evaluation index of RealEstate10K: give its file with "
                "--index evaluation_index_re10k.json"
            )
        return lambda scenes, number: _indexed_choices(scenes, number, re10k_index)
    if protocol == "scannet-8view":
        return _eight_view_choices
    if protocol == "scannet-2view":
        return lambda scenes, number: lsm_protocol(scenes.num_frames(number))

    def of_mipnerf360(scenes: PreparedScenes, number: int) -> list[FrameChoice]:
        choices = mipnerf360_protocol(scenes.num_frames(number))
        middle = len(choices) // 2
        return choices if all_targets else choices[middle : middle + 1]

    return of_mipnerf360


def protocol_scenes(
    scenes: PreparedScenes,
    protocol: DatasetProtocol,
    choose: ChooseFrames,
    *,
    num_scenes: int | None = None,
    model_unit: Unit | None = None,
) -> Iterator[ProtocolScene]:
    """The scenes one after the other, read when their turn comes.

    Scenes without metres get the distance of their first two contexts as the unit, and so do those
    with metres for a model that answers in such distances. A scene or sample that the protocol
    cannot use is left out with a warning that says why.

    Args:
        scenes: Of one of the protocol's data sets.
        protocol: Which; its name stands in messages.
        choose: From `frame_chooser`.
        num_scenes: The first so many alone; None for all.
        model_unit: In which the model answers, if it learned one.

    Raises:
        ValueError: A scene is of another data set, or num_scenes is below 1.
    """
    if num_scenes is not None and num_scenes < 1:
        raise ValueError(f"the number of scenes must be at least 1, got {num_scenes}")
    for number in range(min(len(scenes), num_scenes or len(scenes))):
        scene = protocol_scene(scenes, number, protocol, choose, model_unit=model_unit)
        if scene is not None:
            yield scene


def protocol_scene(
    scenes: PreparedScenes,
    number: int,
    protocol: DatasetProtocol,
    choose: ChooseFrames,
    *,
    model_unit: Unit | None = None,
) -> ProtocolScene | None:
    """One scene of `protocol_scenes`; None, with a warning, where the protocol cannot use it."""
    info = scenes.record(number).info
    if info.dataset not in DATASETS[protocol]:
        raise ValueError(
            f"scene {info.name} is of {info.dataset}, {protocol} is for "
            f"{' or '.join(DATASETS[protocol])}; choose the protocol of the data set"
        )
    unit: Unit = "metre" if info.unit == "metre" and model_unit != "baseline" else "baseline"
    samples = []
    for choice in usable_choices(scenes, number, choose):
        try:
            samples.append(make_sample(scenes, number, choice, unit=unit))
        except NoBaselineError as error:
            warnings.warn(f"scene {info.name}: {error}", stacklevel=2)
    if samples:
        return ProtocolScene(info.name, None, tuple(samples), unit)
    warnings.warn(f"scene {info.name} has no sample by {protocol}", stacklevel=2)
    return None


def usable_choices(scenes: PreparedScenes, number: int, choose: ChooseFrames) -> list[FrameChoice]:
    """The samples of a scene; none, with a warning, where its frames are not those asked for."""
    try:
        return choose(scenes, number)
    except UnusableSceneError as error:
        warnings.warn(f"scene {scenes.name_of(number)}: {error}", stacklevel=2)
        return []


class UnusableSceneError(ValueError):
    """The frames that a protocol asks for are not there."""


def read_re10k_index(path: Path) -> dict[str, Any]:
    """The evaluation index of RealEstate10K: scene to contexts and targets, or to None.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no such index.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no evaluation index {path}")
    try:
        index = read_json(path, "download it again")
        for entry in index.values():
            if entry is not None:
                FrameChoice(*(_frames(entry[part]) for part in ("context", "target")))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{path} is no evaluation index of RealEstate10K: {reason_of(error)}"
        ) from error
    return index


def _frames(value: Any) -> tuple[int, ...]:
    """The numbers of an entry.

    Raises:
        ValueError: They are none.
    """
    if not isinstance(value, list) or not value:
        raise ValueError(f"{reprlib.repr(value)} is no list of frames")
    return tuple(whole_number(each) for each in value)


def _eight_view_choices(scenes: PreparedScenes, number: int) -> list[FrameChoice]:
    try:
        return [eight_view_protocol(scenes.num_frames(number))]
    except ValueError as error:
        raise UnusableSceneError(str(error)) from error


def _indexed_choices(
    scenes: PreparedScenes, number: int, index: Mapping[str, Any]
) -> list[FrameChoice]:
    entry = index.get(scenes.name_of(number))
    if entry is None:
        return []
    sources = scenes.record(number).sources
    return [FrameChoice(_places(sources, entry["context"]), _places(sources, entry["target"]))]


def _places(sources: Sequence[str], wanted: Sequence[int]) -> tuple[int, ...]:
    """Where frames of the clip stand among those that were prepared."""
    place = {source: k for k, source in enumerate(sources)}
    missing = [frame for frame in wanted if str(frame) not in place]
    if missing:
        raise UnusableSceneError(f"frames {missing} of the evaluation index were not prepared")
    return tuple(place[str(frame)] for frame in wanted)
