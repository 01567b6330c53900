"""Ids as a tracker of masks gives them: the same thing comes back under another id."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.data.scenes import SceneFrames, SceneSource

BROKEN_TRACKS = "broken-tracks"
"""Name of these masks among those that a run can learn from."""


@dataclass(frozen=True)
class BreakSettings:
    """How often a track breaks (App. C.1 says when, and gives no number)."""

    on_return: float = 0.7
    """Probability that a thing has a new id when it comes back after frames without it."""
    in_sight: float = 0.03
    """Probability that a thing that stays in sight has a new id from a frame on."""
    min_pixels: int = 20
    """A thing of fewer pixels is out of sight of the tracker."""

    def __post_init__(self) -> None:
        for name in ("on_return", "in_sight"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")


class BrokenTracks:
    """The scenes of a source with tracks instead of true ids; a `SceneSource`.

    Borders of the masks stay true: only what ids say across frames is wrong. The breaks follow from
    the name of the scene and the seed, whichever frames are read.
    """

    def __init__(
        self,
        source: SceneSource,
        settings: BreakSettings = BreakSettings(),
        *,
        seed: int = 0,
    ):
        self.source, self.settings, self.seed = source, settings, seed
        self.credits: Sequence[str] = getattr(source, "credits", ())
        """Whose work the pictures show, one line each."""
        self._tracks: dict[int, tuple[Mapping[int, int], ...]] = {}

    def __len__(self) -> int:
        return len(self.source)

    def name_of(self, number: int) -> str:
        """The name of the scene in its own data set."""
        return self.source.name_of(number)

    def num_frames(self, number: int) -> int:
        """How many frames scene `number` has."""
        return self.source.num_frames(number)

    def frames(self, number: int, chosen: Sequence[int]) -> SceneFrames:
        """These frames of scene `number`; the first call reads all ids of the scene."""
        scene = self.source.frames(number, chosen)
        if number not in self._tracks:
            whole = self.source.frames(number, range(self.num_frames(number)))
            random = np.random.default_rng([self.seed, crc32(scene.name.encode())])
            self._tracks[number] = track_ids(whole.instances, random, self.settings)
        tracks = self._tracks[number]
        maps = [
            _renamed(ids, tracks[frame]) for ids, frame in zip(scene.instances, chosen, strict=True)
        ]
        words = {
            new: scene.words[old]
            for frame in tracks
            for old, new in frame.items()
            if old in scene.words
        }
        return replace(scene, instances=torch.stack(maps) if maps else scene.instances, words=words)


def track_ids(
    instances: Int[Tensor, "frame height width"],
    random: np.random.Generator,
    settings: BreakSettings = BreakSettings(),
) -> tuple[Mapping[int, int], ...]:
    """For each frame the track of every true id; a track has the true id until it breaks.

    Args:
        instances: True ids; below 1 is no instance and stays as it is.
        random: Of the breaks; drawn in the order of ids, then frames.
        settings: How often they happen.
    """
    frames: list[dict[int, int]] = [{} for _ in instances]
    found = [dict(zip(*_counted(ids), strict=True)) for ids in instances]
    names = sorted({name for counts in found for name in counts if name > 0})
    free = max(names, default=0) + 1
    for name in names:
        track, seen, lost = name, False, False
        for frame, counts in enumerate(found):
            in_sight = counts.get(name, 0) >= settings.min_pixels
            draw = random.random()
            if in_sight and seen and draw < (settings.on_return if lost else settings.in_sight):
                track, free = free, free + 1
            lost = seen and not in_sight
            seen = seen or in_sight
            if name in counts:
                frames[frame][name] = track
    return tuple(frames)


def _counted(ids: Int[Tensor, "height width"]) -> tuple[list[int], list[int]]:
    values, counts = ids.unique(return_counts=True)
    return values.tolist(), counts.tolist()


def _renamed(
    ids: Int[Tensor, "height width"], tracks: Mapping[int, int]
) -> Int[Tensor, "height width"]:
    values, places = ids.unique(return_inverse=True)
    new = torch.tensor([tracks.get(value, value) for value in values.tolist()], dtype=ids.dtype)
    return new[places] if len(values) else ids
