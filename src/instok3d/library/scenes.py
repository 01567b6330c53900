"""A scene's objects, as a library takes them."""

import io
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from instok3d.library.entries import Encoder, Entry, SceneEntries
from instok3d.scene.object_pictures import object_picture
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene

THUMBNAIL = 128
"""Longer side of a thumbnail, pixels."""


def choose_encoder(scene: Scene, place: object, wanted: str | None) -> str:
    """The encoder whose features of a scene a library takes.

    Args:
        scene: Any.
        place: Where it lies, for messages.
        wanted: A name, or None where the scene has features of one encoder alone.

    Raises:
        ValueError: The scene has no such features, or those of several encoders.
    """
    known = ", ".join(scene.semantics)
    if not known:
        raise ValueError(
            f"{place} has no semantics, so that nothing in it can be searched for: reconstruct it "
            "with a model that has some"
        )
    if wanted is None and len(scene.semantics) > 1:
        raise ValueError(f"{place} has semantics of several encoders, {known}: give --encoder")
    if wanted is not None and wanted not in scene.semantics:
        raise ValueError(f"{place} has no semantics of {wanted!r}; it has those of {known}")
    return next(iter(scene.semantics)) if wanted is None else wanted


def entries_of(scene: Scene, encoder: str, place: object) -> SceneEntries:
    """The objects of a scene, but for hidden ones and those of which the encoder knows nothing.

    A warning says how many of the latter there are.

    Args:
        scene: Its semantics have the encoder.
        encoder: A name among them.
        place: Where it lies, for messages.
    """
    features = scene.semantics[encoder].of_groups(scene.tokens.assignment).numpy()
    shown = [item for item in scene.objects if not item.hidden]
    kept = [item for item in shown if features[item.id - 1].any()]
    if len(kept) < len(shown):
        warnings.warn(
            f"{place}: {len(shown) - len(kept)} of {len(shown)} objects have no features of "
            f"{encoder}, and are left out",
            stacklevel=2,
        )
    objects = [
        Entry(
            id=item.id,
            key=item.key,
            label=item.label,
            box=np.array([item.aabb.min, item.aabb.max], np.float32),
            thumbnail=thumbnail(scene, item),
        )
        for item in kept
    ]
    rows = [item.id - 1 for item in kept]
    return SceneEntries(Encoder(encoder, features.shape[1]), objects, features[rows])


def thumbnail(scene: Scene, item: SceneObject) -> bytes:
    """An object alone on white, where it is seen best, as a small JPEG file."""
    picture = Image.fromarray(object_picture(scene, item))
    picture.thumbnail((THUMBNAIL, THUMBNAIL))
    stream = io.BytesIO()
    picture.save(stream, "JPEG", quality=85)
    return stream.getvalue()


def scene_place(path: Path) -> str:
    """What a library calls a scene: its absolute place, whatever way it was named."""
    return path.resolve().as_posix()
