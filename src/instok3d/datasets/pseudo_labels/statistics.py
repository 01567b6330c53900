"""How well the ids of a clip hold: how long tracks are, what they cover, where they break."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Integer


@dataclass(frozen=True)
class StatisticsConfig:
    """What counts as a break and as a flicker."""

    break_frames: int = 5
    """A new id must come up within so many frames of the end of the old one."""
    break_iou: float = 0.5
    """... where the old one was last, by this much."""
    break_area_share: float = 0.5
    """... and the old one must have ended large: this share of its median area or more, or it
    went behind something or out of the picture by itself."""
    flicker_frames: int = 2
    """Gaps of so many frames or fewer are flicker; longer ones are returns."""


@dataclass(frozen=True)
class ClipStatistics:
    """Figures of one clip, from its id maps alone."""

    frames: int
    tracks: int
    """Ids that cover a pixel of some frame."""
    mean_track_frames: float
    """Frames in which an id is seen, mean over ids; 0 without ids."""
    coverage: float
    """Share of all pixels that have an id."""
    breaks: int
    """Ids that end while they are large, and whose place a new id takes."""
    breaks_per_track: float
    flickers: int
    """Short gaps in which an id is not seen."""
    returns: int
    """Longer gaps after which an id is seen again."""


@dataclass
class _Track:
    last: int
    areas: list[int] = field(default_factory=list)
    flickers: int = 0
    returns: int = 0


class StatisticsOfClip:
    """Takes id maps in order and keeps what the figures need; memory grows only with tracks."""

    def __init__(self, config: StatisticsConfig = StatisticsConfig()):
        self.config = config
        self._tracks: dict[int, _Track] = {}
        self._recent: deque[tuple[int, np.ndarray]] = deque(maxlen=config.break_frames)
        self._taken_places: dict[int, set[int]] = {}  # of ids by ids that came up after them
        self._frames = self._pixels = self._covered = 0

    def add(self, id_map: Integer[np.ndarray, "height width"]) -> None:
        """Count the next frame."""
        frame = self._frames
        ids, areas = np.unique(id_map, return_counts=True)
        new = []
        for track, area in zip(ids.tolist(), areas.tolist(), strict=True):
            if track == 0:
                continue
            if track not in self._tracks:
                self._tracks[track] = _Track(frame)
                new.append(track)
            self._count(self._tracks[track], frame, area)
        for track in new:
            self._note_place(id_map == track)
        self._recent.append((frame, id_map))
        self._frames += 1
        self._pixels += id_map.size
        self._covered += int((id_map > 0).sum())

    def result(self) -> ClipStatistics:
        """The figures of all frames so far."""
        tracks = self._tracks.values()
        count = len(tracks)
        breaks = sum(map(self._is_broken, self._taken_places))
        return ClipStatistics(
            frames=self._frames,
            tracks=count,
            mean_track_frames=sum(len(track.areas) for track in tracks) / max(count, 1),
            coverage=self._covered / max(self._pixels, 1),
            breaks=breaks,
            breaks_per_track=breaks / max(count, 1),
            flickers=sum(track.flickers for track in tracks),
            returns=sum(track.returns for track in tracks),
        )

    def _count(self, track: _Track, frame: int, area: int) -> None:
        gap = frame - track.last - 1
        if gap > 0 and gap <= self.config.flicker_frames:
            track.flickers += 1
        elif gap > 0:
            track.returns += 1
        track.last = frame
        track.areas.append(area)

    def _note_place(self, mask: Bool[np.ndarray, "height width"]) -> None:
        """Note the ids that were, when they were last seen, where a new one comes up."""
        for frame, before in self._recent:
            if before.shape != mask.shape:
                continue
            for old in np.unique(before[mask]).tolist():
                if old == 0 or self._tracks[old].last != frame:
                    continue
                lying = before == old
                iou = (lying & mask).sum() / (lying | mask).sum()
                if iou >= self.config.break_iou:
                    self._taken_places.setdefault(old, set()).add(self._frames)

    def _is_broken(self, old: int) -> bool:
        """Whether the id ended before the new one came up, for good, and large."""
        track = self._tracks[old]
        ended = any(track.last < frame for frame in self._taken_places[old])
        large = track.areas[-1] >= self.config.break_area_share * float(np.median(track.areas))
        return ended and large
