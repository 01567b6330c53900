"""From proposed and tracked masks to one id map a frame; the model is behind two interfaces.

Masks are proposed on keyframes. What no track covers becomes a new track, which is followed
forwards to the end and backwards to the keyframe before. Frames come and go one by one: only
those since the last keyframe are held, and tracks unseen for long are forgotten, so the memory
does not grow with the clip.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, UInt8, UInt16

from instok3d.datasets.pseudo_labels.interfaces import (
    MaskProposer,
    MaskTracker,
    ProposedMasks,
    TrackedMask,
)
from instok3d.datasets.pseudo_labels.mask_sets import overlap_ious, painted, visible_shares

MAX_TRACKS = 2**16 - 1


@dataclass(frozen=True)
class AssociationConfig:
    """When masks are one thing. The paper names SAM 2 without a procedure: the values are ours."""

    keyframe_step: int = 10
    """Masks are proposed on every so many frames, and on the last."""
    match_iou: float = 0.5
    """A proposed mask that overlaps every tracked one by less is a new track."""
    min_area_share: float = 0.0005
    """Proposed masks below this share of the image are left out (33 pixels of 256 x 256)."""
    min_visible_share: float = 0.5
    """A new mask is left out if smaller masks cover more of it: it only joins known things."""
    link_iou: float = 0.5
    """A new track that, followed backwards, lies on a lost one by this much takes its id."""
    duplicate_iou: float = 0.8
    """Of two tracks that lie on each other by this much in a keyframe the younger ends."""
    reentry_frames: int = 0
    """A new mask also takes the id of a track lost up to so many frames ago where that was last
    seen (by link_iou). 0 = off: right for a camera that stands, wrong for one that turns fast."""
    forget_after: int = 100
    """Tracks unseen for so many frames are given up; what returns later gets a new id."""

    def __post_init__(self):
        if self.keyframe_step < 1 or self.forget_after < 1 or self.reentry_frames < 0:
            raise ValueError(
                "keyframe_step and forget_after must be 1 or more and reentry_frames 0 or more, "
                f"got {self.keyframe_step}, {self.forget_after} and {self.reentry_frames}"
            )
        for name in ("match_iou", "min_area_share", "min_visible_share", "link_iou",
                     "duplicate_iou"):  # fmt: skip
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")


@dataclass
class _Frame:
    """One frame since the last keyframe, and that keyframe itself."""

    number: int
    image: UInt8[np.ndarray, "height width 3"]
    tracked: dict[int, TrackedMask]
    """Tracks that are seen in it."""


@dataclass(frozen=True)
class _LastSeen:
    frame: int
    mask: Bool[np.ndarray, "height width"]


def label_clip(
    images: Iterable[UInt8[np.ndarray, "height width 3"]],
    proposer: MaskProposer,
    tracker: MaskTracker,
    config: AssociationConfig = AssociationConfig(),
) -> Iterator[UInt16[np.ndarray, "height width"]]:
    """One id map for each frame, in order; an id is one thing in the whole clip, 0 = uncovered.

    Args:
        images: Consecutive sRGB frames of one size; taken one by one.
        proposer: Asked on keyframes.
        tracker: One session follows all tracks forwards, and one a keyframe the new ones back.
        config: When masks are one thing.

    Raises:
        ValueError: The frames differ in size, or there are more than 65,535 tracks.
    """
    clip = _Clip(proposer, tracker, config)
    last: UInt8[np.ndarray, "height width 3"] | None = None
    for image in images:
        if last is not None:
            yield from clip.take(last, is_last=False)
            if image.shape != last.shape:
                raise ValueError(
                    f"a frame of {image.shape[0]}x{image.shape[1]} follows one of "
                    f"{last.shape[0]}x{last.shape[1]}; all frames of a clip must have one size"
                )
        last = image
    if last is not None:
        yield from clip.take(last, is_last=True)


class _Clip:
    """The tracks of a clip up to the present frame."""

    def __init__(self, proposer: MaskProposer, tracker: MaskTracker, config: AssociationConfig):
        self.proposer, self.tracker, self.config = proposer, tracker, config
        self.session = tracker.start()
        self.held: list[_Frame] = []  # the last keyframe, whose map is out, and all after it
        self.last_seen: dict[int, _LastSeen] = {}  # of every track that is followed
        self.num_frames = self.num_tracks = 0

    def take(
        self, image: UInt8[np.ndarray, "height width 3"], *, is_last: bool
    ) -> list[UInt16[np.ndarray, "height width"]]:
        """Go on by a frame; the id maps that are final now."""
        frame = _Frame(self.num_frames, image, _seen(self.session.step(image)))
        self.held.append(frame)
        self.num_frames += 1
        for track, tracked in frame.tracked.items():
            self.last_seen[track] = _LastSeen(frame.number, tracked.mask)
        if frame.number % self.config.keyframe_step and not is_last:
            return []
        self._end_duplicates(frame)
        self._take_up_new(frame)
        self._forget_long_lost(frame)
        first = 1 if frame.number else 0  # the keyframe before is out already
        maps = [_id_map(each) for each in self.held[first:]]
        self.held = [frame]
        return maps

    def _end_duplicates(self, key: _Frame) -> None:
        """End the younger of two tracks that lie on each other, in all held frames."""
        tracks = sorted(key.tracked)
        masks = _stack([key.tracked[track].mask for track in tracks], key.image)
        on_each_other = overlap_ious(masks, masks) >= self.config.duplicate_iou
        ended: dict[int, int] = {}
        for place, track in enumerate(tracks):
            for elder in tracks[:place]:
                if elder not in ended and on_each_other[place, tracks.index(elder)]:
                    ended.setdefault(track, elder)
        for track, elder in ended.items():
            self._cut_back(track, elder)
        self.session.forget(ended)

    def _cut_back(self, track: int, elder: int) -> None:
        """Take a track out of the held frames in which it lies on an elder one."""
        del self.last_seen[track]
        for frame in self.held:
            if track not in frame.tracked:
                continue
            mask = frame.tracked[track].mask
            on_elder = elder in frame.tracked and (
                overlap_ious(mask[None], frame.tracked[elder].mask[None])[0, 0]
                >= self.config.duplicate_iou
            )
            if on_elder:
                del frame.tracked[track]
            else:
                self.last_seen[track] = _LastSeen(frame.number, mask)  # it may be found again

    def _take_up_new(self, key: _Frame) -> None:
        """Propose masks on a keyframe and follow those that are new both ways."""
        new = self._new_masks(self.proposer.propose(key.image), key)
        fresh = {-number: each for number, each in enumerate(new, start=1)}  # until they are named
        back = self._followed_back(fresh)
        names = self._linked(back, key)
        for number in fresh:
            if number not in names:
                names[number] = self._next_id()
        for frame, masks in zip(self.held, back, strict=True):
            for number, tracked in masks.items():
                # What the track itself saw there stands; the last keyframe's map is out.
                frame.tracked.setdefault(names[number], tracked)
        self.session.add({names[number]: each.mask for number, each in fresh.items()})
        for number, each in fresh.items():
            self.last_seen[names[number]] = _LastSeen(key.number, each.mask)

    def _next_id(self) -> int:
        if self.num_tracks == MAX_TRACKS:
            raise ValueError(
                f"the clip has more than {MAX_TRACKS} tracks by frame {self.num_frames - 1}; cut "
                "it into shorter ones"
            )
        self.num_tracks += 1
        return self.num_tracks

    def _new_masks(self, proposed: ProposedMasks, key: _Frame) -> list[TrackedMask]:
        """The proposed masks that no track covers, surest first."""
        tracked = _stack([each.mask for each in key.tracked.values()], key.image)
        large = proposed.masks.sum(axis=(1, 2)) >= max(
            1, self.config.min_area_share * key.image.shape[0] * key.image.shape[1]
        )
        ious = overlap_ious(proposed.masks, tracked)
        fresh = large & (ious < self.config.match_iou).all(axis=1)
        masks, scores = proposed.masks[fresh], proposed.scores[fresh]
        shares = visible_shares(np.concatenate([masks, tracked]))[: len(masks)]
        order = np.argsort(-scores, kind="stable")
        return [
            TrackedMask(masks[k], float(scores[k]))
            for k in order
            if shares[k] >= self.config.min_visible_share
        ]

    def _followed_back(self, fresh: Mapping[int, TrackedMask]) -> list[dict[int, TrackedMask]]:
        """Where the new masks of the last held frame were in every held frame."""
        back = [dict(fresh)]
        if not fresh or len(self.held) == 1:
            return [*[{} for _ in self.held[1:]], *back]
        session = self.tracker.start()
        session.step(self.held[-1].image)
        session.add({number: each.mask for number, each in fresh.items()})
        following = set(fresh)
        for frame in reversed(self.held[:-1]):
            found = _seen(session.step(frame.image)) if following else {}
            # One that is gone was not there yet: what comes up before is something else.
            gone = following - found.keys()
            session.forget(gone)
            following -= gone
            back.append(found)
        return back[::-1]

    def _linked(self, back: list[dict[int, TrackedMask]], key: _Frame) -> dict[int, int]:
        """The tracks, lost by now, that new masks are the continuation of; one to one."""
        lost = [track for track in self.last_seen if track not in key.tracked]
        pairs = [
            (self._evidence(number, track, back), number, track)
            for number in back[-1]
            for track in lost
        ]
        names: dict[int, int] = {}
        for iou, number, track in sorted(pairs, key=lambda pair: (-pair[0], -pair[1], pair[2])):
            free = number not in names and track not in names.values()
            if free and iou > 0 and iou >= self.config.link_iou:
                names[number] = track
        return names

    def _evidence(self, number: int, track: int, back: list[dict[int, TrackedMask]]) -> float:
        """How much a new mask followed back lies on a lost track: IoU over the frames of both."""
        shared = union = 0
        for frame, masks in zip(self.held, back, strict=True):
            if number in masks and track in frame.tracked:
                mine, theirs = masks[number].mask, frame.tracked[track].mask
                shared += int((mine & theirs).sum())
                union += int((mine | theirs).sum())
        if union:
            return shared / union
        place = next(k for k, masks in enumerate(back) if number in masks)
        seen = self.last_seen[track]
        if self.held[place].number - seen.frame > self.config.reentry_frames:
            return 0.0
        return float(overlap_ious(back[place][number].mask[None], seen.mask[None])[0, 0])

    def _forget_long_lost(self, key: _Frame) -> None:
        limit = key.number - self.config.forget_after
        old = [track for track, seen in self.last_seen.items() if seen.frame < limit]
        self.session.forget(old)
        for track in old:
            del self.last_seen[track]


def _seen(tracked: Mapping[int, TrackedMask]) -> dict[int, TrackedMask]:
    return {track: each for track, each in tracked.items() if each.mask.any()}


def _stack(
    masks: list[Bool[np.ndarray, "height width"]], image: UInt8[np.ndarray, "height width 3"]
) -> Bool[np.ndarray, "mask height width"]:
    return np.stack(masks) if masks else np.zeros((0, *image.shape[:2]), dtype=bool)


def _id_map(frame: _Frame) -> UInt16[np.ndarray, "height width"]:
    tracked = frame.tracked.values()
    masks, scores = [each.mask for each in tracked], [each.score for each in tracked]
    height, width, _ = frame.image.shape
    return painted(masks, scores, list(frame.tracked), (height, width))
