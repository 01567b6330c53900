"""What files say of a scene's frame, units and origin, in lines of text; read back from them."""

import math
from collections.abc import Iterable
from typing import Literal

from instok3d.scene.edits.disclosure import edited_words
from instok3d.scene.scene import Scene

UP, UNITS = "Vertical axis:", "instok3d units:"
"""How the lines begin that are read again; the first is Brush's spelling."""


def scene_comments(scene: Scene, *, sorted_by_object: bool = True) -> tuple[str, ...]:
    """What a file of a scene's Gaussians says of it, a line each.

    The vertical axis is left out where it is not known well enough.

    Args:
        scene: That is written.
        sorted_by_object: Whether the Gaussians of each object stay together in the file.
    """
    vertical, world = scene.vertical, f"instok3d world: {scene.frame}"
    up = " ".join(f"{value:.4g}" for value in vertical.up)
    if scene.frame == "first camera":
        world += ", OpenCV axes (x right, y down, z forward)"
    elif vertical.source == "given":
        world += ", their axes; up as it was given"
    elif vertical.is_stated:
        world += f", their axes; up estimated, confidence {vertical.confidence:.2f}"
    else:
        world += ", their axes; up unknown"
    order = (
        "sorted by object; rows of each object in objects.json, gaussian_range"
        if sorted_by_object
        else "the file's own; gaussian_range of objects.json does not hold in it"
    )
    return (
        "SplatRenderMode: default",
        *([f"{UP} {up}"] if vertical.is_stated else []),
        f"instok3d generator: {scene.provenance.generator}",
        *([f"instok3d {edited_words(scene)}"] if scene.provenance.edits else []),
        world,
        f"{UNITS} {scene.units}",
        f"instok3d order: {order}",
    )


def stated_up(lines: Iterable[str]) -> tuple[float, float, float] | None:
    """The up direction that lines of a file state, of length 1; None where they state none."""
    for line in lines:
        if line.startswith(UP):
            try:
                x, y, z = (float(word) for word in line.removeprefix(UP).split())
            except ValueError:
                return None
            length = math.hypot(x, y, z)
            usable = math.isfinite(length) and length > 0
            return (x / length, y / length, z / length) if usable else None
    return None


def stated_units(lines: Iterable[str]) -> Literal["metres", "arbitrary"]:
    """The unit of length that lines of a file state; "arbitrary" where they state none."""
    return "metres" if f"{UNITS} metres" in lines else "arbitrary"
