"""Objects as a library takes them, made by hand."""

from collections.abc import Sequence

import numpy as np

from instok3d.library.entries import Encoder, Entry, SceneEntries

ENCODER = Encoder("made-1", 6)


def made_entries(
    count: int = 3, seed: int = 0, encoder: Encoder = ENCODER, labels: Sequence[str] = ()
) -> SceneEntries:
    """So many objects with random embeddings; of the labels as many as there are."""
    rng = np.random.default_rng(seed)
    objects = [
        Entry(
            id=index + 1,
            key=f"object#{index + 1}",
            label=labels[index] if index < len(labels) else None,
            box=np.array([[0, 0, 0], [1, 2, index + 1]], np.float32),
            thumbnail=b"\xff\xd8" + bytes([seed % 256, index % 256]) * (index % 5),
        )
        for index in range(count)
    ]
    return SceneEntries(encoder, objects, rng.standard_normal((count, encoder.channels)))
