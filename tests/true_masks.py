"""A mask proposer and tracker that know the truth of a clip, and can be made worse on purpose."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from instok3d.datasets.pseudo_labels.interfaces import ProposedMasks, TrackedMask

WHOLE = "whole"


@dataclass(frozen=True)
class TrueClip:
    images: np.ndarray
    """No two are equal: a frame is known by its picture."""
    ids: np.ndarray

    def frame_of(self, image: np.ndarray) -> int:
        return next(k for k, known in enumerate(self.images) if np.array_equal(known, image))


@dataclass(frozen=True)
class Damage:
    """What goes wrong; frames and true ids."""

    unproposed: frozenset[tuple[int, int]] = frozenset()
    """(id, frame): not among the proposals of this frame."""
    split: frozenset[tuple[int, int]] = frozenset()
    """(id, frame): proposed as a left third and a right rest."""
    united: tuple[tuple[int, tuple[int, ...]], ...] = ()
    """(frame, ids): also proposed as one mask."""
    lost: frozenset[tuple[int, int]] = frozenset()
    """(id, frame): tracks of the thing, going forwards, lose it in this frame for good."""
    drift: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """(id, frame): tracks of the thing go over to another one in this frame."""
    memory: int | None = None
    """After so many frames out of sight a track does not find its thing again."""
    jitter: int = 0
    """Masks of tracks are shifted by up to so many pixels."""


class TrueMasks:
    """A `LabelModel`: proposes every id of a frame, and tracks them."""

    def __init__(self, clip: TrueClip, damage: Damage = Damage()) -> None:
        self.clip, self.damage = clip, damage
        self.sessions: list[TrueSession] = []
        self.proposed_on: list[int] = []

    def propose(self, image: np.ndarray) -> ProposedMasks:
        frame = self.clip.frame_of(image)
        self.proposed_on.append(frame)
        ids = self.clip.ids[frame]
        masks = []
        for name in np.unique(ids[ids > 0]).tolist():
            if (name, frame) in self.damage.unproposed:
                continue
            if (name, frame) in self.damage.split:
                masks += _thirds(ids == name)
            else:
                masks.append(ids == name)
        masks += [np.isin(ids, names) for at, names in self.damage.united if at == frame]
        # The order of the ids must not help: the largest id is the surest.
        scores = 0.9 + 0.0001 * np.arange(len(masks))
        return ProposedMasks(np.array(masks, dtype=bool).reshape(-1, *ids.shape), scores)

    def start(self) -> "TrueSession":
        self.sessions.append(TrueSession(self.clip, self.damage))
        return self.sessions[-1]

    def identity(self) -> dict[str, Any]:
        return {"model": "truth", "weights_sha256": "0" * 64, "library": "none 0"}


@dataclass
class _Followed:
    name: int | None
    part: str
    unseen: int = 0


class TrueSession:
    def __init__(self, clip: TrueClip, damage: Damage) -> None:
        self.clip, self.damage = clip, damage
        self.tracks: dict[int, _Followed] = {}
        self.frame = -1
        self.most_tracks = 0

    def step(self, image: np.ndarray) -> dict[int, TrackedMask]:
        before, self.frame = self.frame, self.clip.frame_of(image)
        forwards = before < self.frame
        return {
            track: TrackedMask(self._follow(followed, forwards, track), 0.9)
            for track, followed in self.tracks.items()
        }

    def add(self, masks: Mapping[int, np.ndarray]) -> None:
        ids = self.clip.ids[self.frame]
        for track, mask in masks.items():
            name = int(np.bincount(ids[mask]).argmax())
            parts = dict(zip(("left", "right"), _thirds(ids == name), strict=True))
            fitting = [part for part, each in parts.items() if np.array_equal(each, mask)]
            is_whole = not fitting or np.array_equal(mask, ids == name)
            self.tracks[track] = _Followed(name, WHOLE if is_whole else fitting[0])
        self.most_tracks = max(self.most_tracks, len(self.tracks))

    def forget(self, tracks: Iterable[int]) -> None:
        for track in tracks:
            self.tracks.pop(track, None)

    def _follow(self, followed: _Followed, forwards: bool, track: int) -> np.ndarray:
        ids = self.clip.ids[self.frame]
        if forwards and (followed.name, self.frame) in self.damage.lost:
            followed.name = None
        if forwards and followed.name is not None:
            followed.name = self.damage.drift.get((followed.name, self.frame), followed.name)
        if followed.name is None:
            return np.zeros(ids.shape, dtype=bool)
        mask = ids == followed.name
        followed.unseen = 0 if mask.any() else followed.unseen + 1
        if self.damage.memory is not None and followed.unseen > self.damage.memory:
            followed.name = None
        if followed.part != WHOLE and mask.any():
            left, right = _thirds(mask)
            mask = left if followed.part == "left" else right
        rng = np.random.default_rng([abs(track), int(track < 0), self.frame])
        shift = rng.integers(-self.damage.jitter, self.damage.jitter + 1, 2)
        return _shifted(mask, int(shift[0]), int(shift[1]))


def id_consistency(labels: np.ndarray, truth: np.ndarray) -> float:
    """Share of the pixels of true things, over all frames, whose id stands for their thing, and
    for no other, under the best one-to-one naming."""
    there = truth > 0
    names, rows = np.unique(truth[there], return_inverse=True)
    found, columns = np.unique(labels[there], return_inverse=True)
    counts = np.zeros((len(names), len(found)), dtype=np.int64)
    np.add.at(counts, (rows, columns), 1)
    counts[:, found == 0] = 0
    return counts[linear_sum_assignment(-counts)].sum() / there.sum()


def boxes_clip(
    frames: list[dict[int, tuple[int, int, int, int]]], size: tuple[int, int] = (16, 32)
) -> TrueClip:
    """Boxes (top, left, bottom, right) by id; larger ids lie before smaller ones."""
    rng = np.random.default_rng(0)
    ids = np.zeros((len(frames), *size), dtype=np.int64)
    for frame, boxes in enumerate(frames):
        for name, (top, left, bottom, right) in sorted(boxes.items()):
            ids[frame, top:bottom, left:right] = name
    return TrueClip(rng.integers(0, 256, (*ids.shape, 3)).astype(np.uint8), ids)


def _thirds(mask: np.ndarray) -> list[np.ndarray]:
    columns = np.flatnonzero(mask.any(axis=0))
    cut = columns[len(columns) // 3] if len(columns) else 0
    left = mask & (np.arange(mask.shape[1]) < cut)
    return [left, mask & ~left]


def _shifted(mask: np.ndarray, down: int, right: int) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    rows, columns = rows + down, columns + right
    inside = (rows >= 0) & (rows < mask.shape[0]) & (columns >= 0) & (columns < mask.shape[1])
    moved = np.zeros_like(mask)
    moved[rows[inside], columns[inside]] = True
    return moved
