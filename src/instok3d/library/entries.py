"""What a library keeps of a scene, and what it answers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Encoder:
    """What the embeddings of a library were made by: only its texts and images can be compared."""

    name: str
    """Of encoder and version."""
    channels: int


@dataclass(frozen=True)
class Entry:
    """One object of a scene."""

    id: int
    """As in the scene."""
    key: str
    label: str | None
    box: Float[np.ndarray, "2 3"]
    """Lowest and highest corner, scene units."""
    thumbnail: bytes
    """A JPEG file."""

    def to_json(self) -> dict[str, Any]:
        """All but the thumbnail, in plain values; lengths in scene units."""
        low, high = self.box.tolist()
        return {"id": self.id, "key": self.key, "label": self.label,
                "box": {"min": low, "max": high}}  # fmt: skip


@dataclass(frozen=True)
class SceneEntries:
    """The objects of one scene, as a library takes them."""

    encoder: Encoder
    objects: Sequence[Entry]
    embeddings: Float[np.ndarray, "object channel"]
    """Of any length but 0."""

    def __post_init__(self) -> None:
        wanted = (len(self.objects), self.encoder.channels)
        if self.embeddings.shape != wanted:
            raise ValueError(f"embeddings of shape {self.embeddings.shape}, wanted {wanted}")
        if not np.isfinite(self.embeddings).all() or not self.embeddings.any(axis=1).all():
            raise ValueError("embeddings must be finite and not 0")


@dataclass(frozen=True)
class Match:
    """An object that a library found."""

    scene: str
    """The scene's place when it was added."""
    object: Entry
    score: float
    """Cosine of its embedding and what was asked for."""

    def to_json(self) -> dict[str, Any]:
        """In plain values."""
        return {"scene": self.scene, "score": self.score, **self.object.to_json()}


@dataclass(frozen=True)
class StoredScene:
    """A scene of a library."""

    scene: str
    objects: int


@dataclass(frozen=True)
class Audit:
    """What a library was found to hold when every byte of it was looked at."""

    scenes: int
    objects: int
    bytes: int


@runtime_checkable
class SceneLibrary(Protocol):
    """What libraries do, wherever they keep their objects."""

    @property
    def encoder(self) -> Encoder | None:
        """Of its embeddings; None as long as nothing was added."""
        ...

    def add(self, scene: str, entries: SceneEntries) -> None:
        """Add a scene, or put it in place of what was added from the same place."""
        ...

    def remove(self, scenes: Sequence[str]) -> None:
        """Take scenes out."""
        ...

    def scenes(self) -> list[StoredScene]:
        """All scenes, in the order of their places."""
        ...

    def query(self, embedding: Float[np.ndarray, " channel"], count: int) -> list[Match]:
        """The objects nearest to an embedding, nearest first."""
        ...

    def compact(self) -> None:
        """Give back the room of what was taken out."""
        ...

    def verify(self) -> Audit:
        """Look at everything that is kept."""
        ...


def check_encoder(library: Encoder | None, other: Encoder, place: object) -> None:
    """Fail where embeddings of two encoders would be compared.

    Args:
        library: Of the library; None takes any.
        other: Of what is added or asked.
        place: The library.

    Raises:
        ValueError: They are not the same.
    """
    if library is not None and library != other:
        raise ValueError(
            f"{place} holds embeddings of the encoder {library.name!r} ({library.channels} "
            f"channels), not of {other.name!r} ({other.channels}): these cannot be compared; use "
            "the encoder of the library, or another library"
        )
