"""What the labelling of a clip asks of a segmentation model: masks of an image, and tracks."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, UInt8


@dataclass(frozen=True)
class ProposedMasks:
    """Masks of one image; they may overlap."""

    masks: Bool[np.ndarray, "mask height width"]
    scores: Float[np.ndarray, " mask"]
    """Larger is surer."""


@dataclass(frozen=True)
class TrackedMask:
    """Where one track is in one frame."""

    mask: Bool[np.ndarray, "height width"]
    """Empty where the tracker does not see it."""
    score: float
    """Larger is surer; comparable between the tracks of one frame."""


@runtime_checkable
class MaskProposer(Protocol):
    """Finds the things in an image without prompts."""

    def propose(self, image: UInt8[np.ndarray, "height width 3"], /) -> ProposedMasks:
        """The masks of one sRGB image."""
        ...


@runtime_checkable
class TrackingSession(Protocol):
    """Follows masks through frames that are given one by one, in order of time or against it."""

    def step(self, image: UInt8[np.ndarray, "height width 3"], /) -> dict[int, TrackedMask]:
        """Go on to the next frame; says where every track is in it."""
        ...

    def add(self, masks: Mapping[int, Bool[np.ndarray, "height width"]], /) -> None:
        """Take up tracks with their masks in the frame of the last step; known ones are put right.

        A track that was put right goes on from the new mask.
        """
        ...

    def forget(self, tracks: Iterable[int], /) -> None:
        """Give these tracks up, and the memory that they hold."""
        ...


@runtime_checkable
class MaskTracker(Protocol):
    """Starts sessions, which know nothing of each other."""

    def start(self) -> TrackingSession:
        """A session without frames or tracks."""
        ...
