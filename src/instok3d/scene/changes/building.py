"""What neither moves nor comes nor goes."""

from instok3d.scene.objects import SceneObject

BUILDING = frozenset({"wall", "floor", "ceiling", "window", "door"})
"""What has these labels does not change; other groups of it only look so."""
SURE = 0.8
"""Probability from which on such a label of the semantics counts: curtains may look like walls."""
OF_BUILDING = "a part of the building, which does not change"


def of_building(item: SceneObject) -> bool:
    """Whether an object is named as a part of the building, by somebody or with certainty."""
    sure = item.label_score is None or item.label_score >= SURE
    return item.label in BUILDING and sure
