"""Objects that edits take: found in the scene, made anew, carried elsewhere."""

from dataclasses import replace

from instok3d.geometry.moving import NO_TURN, Similarity, carry_gaussians
from instok3d.pictures import display_color
from instok3d.scene.boxes import AlignedBox, OrientedBox
from instok3d.scene.edits.ownership import Part
from instok3d.scene.names import key_of
from instok3d.scene.objects import SceneObject, find_object
from instok3d.scene.record import SceneRecord
from instok3d.types import check_gaussians


def object_of(scene: SceneRecord, which: int | str) -> SceneObject:
    """The object of an id, a key or a label; see `find_object`."""
    return find_object(scene.objects, which)


def another_of(scene: SceneRecord, item: SceneObject) -> SceneObject:
    """A new object with the label of another one."""
    new = new_object(scene, item.label, item.confidence)
    return replace(new, label_source=item.label_source, label_score=item.label_score)


def new_object(scene: SceneRecord, label: str | None, confidence: float) -> SceneObject:
    """An object with the next id, which is described when it has Gaussians."""
    number, nowhere = len(scene.tokens.groups) + 1, (0.0, 0.0, 0.0)
    return SceneObject(
        id=number, key=key_of(number, label), color=display_color(number),
        aabb=AlignedBox(nowhere, nowhere), obb=OrientedBox(nowhere, nowhere, NO_TURN),
        centroid=nowhere, num_anchors=0, num_gaussians=0, gaussian_range=(0, 0),
        confidence=confidence, label=label,
    )  # fmt: skip


def carried(part: Part, motion: Similarity) -> Part:
    """A part moved, turned, scaled.

    Raises:
        ValueError: It would be too far away, too large or too small to be drawn.
    """
    gaussians = carry_gaussians(part.gaussians, motion)
    check_gaussians(gaussians, "the object, moved like this,")
    return replace(part, gaussians=gaussians, positions=motion.points(part.positions))
