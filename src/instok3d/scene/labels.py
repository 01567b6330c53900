"""Labels by semantics, given to the objects of a new scene."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

from instok3d.scene.names import FILE, SEMANTICS, USER, key_of
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord
from instok3d.semantics.labels import ClassLabel

AnyScene = TypeVar("AnyScene", bound=SceneRecord)


def with_labels(scene: AnyScene, labels: Mapping[int, ClassLabel], encoder: str) -> AnyScene:
    """The scene with its objects named by semantics, and keys such as "chair#3".

    What a person or a file named keeps its name. Keys hold the object's id, so that edits, undo and
    labels of another encoder never give one key to two objects.

    Args:
        scene: Before its first edit, or the source of its log.
        labels: By the objects' ids; others stay as they are.
        encoder: Which gave them.
    """
    objects = tuple(
        _named(item, labels[item.id], encoder) if item.id in labels else item
        for item in scene.objects
    )
    return replace(scene, objects=objects)


def _named(item: SceneObject, label: ClassLabel, encoder: str) -> SceneObject:
    if item.label_source in (USER, FILE):
        return item
    return replace(
        item, label=label.name, key=key_of(item.id, label.name),
        label_source=f"{SEMANTICS}{encoder}", label_score=label.score,
    )  # fmt: skip
