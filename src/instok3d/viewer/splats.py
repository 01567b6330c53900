"""The Gaussians of a scene as the arrays that a splat viewer draws, in parts that can be moved."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.moving import Point
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.geometry.spherical_harmonics import evaluate_sh
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians
from instok3d.viewer.session import Shown

OWN_PARTS = 200
"""Objects that are parts of their own, those with the most Gaussians: a viewer holds few parts."""
HIGHLIGHT = (1.0, 0.75, 0.1)
"""Colour of what is selected, sRGB."""
HIGHLIGHT_SHARE, INSTANCE_SHARE = 0.5, 0.75
"""Of those colours in the picture."""
LARGEST_COVARIANCE = 6e4
"""In half precision; in square units of a part."""


@dataclass(frozen=True)
class Part:
    """Some Gaussians of a scene, drawn together."""

    rows: slice | Int[Tensor, " row"]
    """Of the scene; a slice where they follow each other, which copies nothing."""
    tints: Float[Tensor, "row 4"]
    """A colour and its share."""


@dataclass(frozen=True)
class Splats:
    """What is drawn of a part."""

    unit: float
    """Scene units in one unit of the lengths below."""
    centers: Float[np.ndarray, "splat 3"]
    """World axes and origin."""
    covariances: Float[np.ndarray, "splat 3 3"]
    """About 1, since the viewer keeps them in half precision."""
    colors: Float[np.ndarray, "splat 3"]
    """SRGB in [0, 1], as seen from one point: the viewer knows no others."""
    opacities: Float[np.ndarray, "splat 1"]


def parts_of(shown: Shown) -> dict[int, Part]:
    """What is drawn, in parts: objects by their ids, and 0 for all that is no part of its own.

    The largest objects are parts of their own, and the selected ones, which can be moved.
    """
    scene = shown.scene
    largest = sorted(scene.objects, key=lambda item: -item.num_gaussians)[:OWN_PARTS]
    own = {item.id for item in largest} | shown.selected
    tints = torch.zeros(len(scene.gaussians.means), 4)
    others = torch.ones(len(tints), dtype=torch.bool)
    rows: dict[int, slice | Tensor] = {}
    for item in scene.objects:
        start, count = item.gaussian_range
        span = slice(start, start + count)
        if shown.instance_colors:
            tints[span] = torch.tensor([*_rgb(item.color), INSTANCE_SHARE])
        if item.id in shown.selected:
            tints[span] = torch.tensor([*HIGHLIGHT, HIGHLIGHT_SHARE])
        if item.hidden or item.id in own:
            others[span] = False
        if item.id in own and not item.hidden:
            rows[item.id] = span
    rest = others.nonzero()[:, 0]
    if len(rest):
        first, last = int(rest[0]), int(rest[-1]) + 1
        rows[0] = slice(first, last) if last - first == len(rest) else rest
    return {number: Part(each, tints[each]) for number, each in rows.items()}


@torch.no_grad()
def splats_of(scene: Scene, part: Part, eye: Point) -> Splats:
    """The Gaussians of a part, in the colours that they have from a point."""
    gaussians = scene.gaussians.rows(part.rows).map(lambda value: value.detach().cpu())
    unit = float(gaussians.scales.amax(1).median())
    axes = quat_to_matrix(gaussians.quats) * (gaussians.scales / unit)[:, None, :]
    covariances = (axes @ axes.mT).clamp(-LARGEST_COVARIANCE, LARGEST_COVARIANCE)
    colors, share = seen_from(gaussians, eye), part.tints[:, 3:]
    colors = colors + share * (part.tints[:, :3] - colors)
    return Splats(
        unit, (gaussians.means / unit).numpy(), covariances.numpy(), colors.numpy(),
        gaussians.opacities[:, None].numpy(),
    )  # fmt: skip


def seen_from(gaussians: Gaussians, eye: Point) -> Float[Tensor, "gaussian 3"]:
    """Colours in [0, 1] from a point."""
    away = gaussians.means - torch.tensor(eye)
    directions = torch.nn.functional.normalize(away, dim=-1)
    return (evaluate_sh(gaussians.sh, directions) + 0.5).clamp(0, 1)


def drawn_alike(before: Scene, after: Scene, first: Part, second: Part) -> bool:
    """Whether two parts of two states of a scene look the same, bit for bit."""
    if first.tints.shape != second.tints.shape or not torch.equal(first.tints, second.tints):
        return False
    if before.gaussians is after.gaussians and first.rows is second.rows:
        return True
    names = ("means", "quats", "scales", "opacities", "sh")
    one, other = vars(before.gaussians), vars(after.gaussians)
    return all(torch.equal(one[name][first.rows], other[name][second.rows]) for name in names)


def _rgb(color: str) -> Sequence[float]:
    """SRGB in [0, 1] of #rrggbb."""
    return [int(color[start : start + 2], 16) / 255 for start in (1, 3, 5)]
