"""What the cameras of a capture show: depth, colours and objects of every pixel, drawn once."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter
from torch import Tensor

from instok3d.geometry.cameras import project, transform_points
from instok3d.scene.changes.traits import weighted_lab

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

FAR_OFF = 0.35
"""Difference of the logarithms of depths beyond which a point is not where a pixel shows it."""
NOISE = 0.06
"""Usual difference of the logarithms of depths, of one thing in two captures."""
SMOOTH = 10 / 128
"""Over how much of a picture's width errors of depth are alike."""
LITTLE = 0.002
"""Points for each pixel below which the bias is taken for smaller than it looks."""
FITS = 4


@dataclass(frozen=True)
class Eyes:
    """Renders at the input cameras of a scene that has some."""

    scene: "Scene"
    depths: Float[Tensor, "view height width"]
    """z-depth, scene units, 0 where nothing is."""
    colors: Float[Tensor, "view height width 3"]
    """Lab with less lightness (`traits.weighted_lab`)."""
    ids: Int[Tensor, "view height width"]
    """Object ids, 0 for none."""

    def looked_at(self, points: Float[Tensor, "point 3"]) -> "list[Look]":
        """Where each view has some points, of this scene's world."""
        return [self._look(view, points) for view in range(len(self.scene.views))]

    def _look(self, view: int, points: Float[Tensor, "point 3"]) -> "Look":
        scene = self.scene
        local = transform_points(scene.cameras.cam_from_world[view].double(), points)
        pixels = project(local, scene.cameras.intrinsics[view].double())
        near, _ = scene.near_far
        # A point behind the camera may have a pixel of any value, which no integer can hold.
        x, y = pixels.nan_to_num().clamp(-1, 1e6).floor().long().unbind(1)
        inside = (local[:, 2] > near) & (x >= 0) & (y >= 0)
        inside &= (x < scene.width) & (y < scene.height)
        x, y = x.clamp(0, scene.width - 1), y.clamp(0, scene.height - 1)
        shown = self.depths[view][y, x]
        inside &= shown > 0
        ratio = (shown.clamp_min(1e-12) / local[:, 2].clamp_min(1e-12)).log()
        return Look(view, x, y, local[:, 2], inside, torch.where(inside, ratio, 0.0))


@dataclass(frozen=True)
class Look:
    """Points of another capture in one view."""

    view: int
    x: Int[Tensor, " point"]
    y: Int[Tensor, " point"]
    z: Float[Tensor, " point"]
    """Depth of the points, scene units."""
    inside: Bool[Tensor, " point"]
    """Whether it is in the picture, where something is drawn."""
    ratio: Float[Tensor, " point"]
    """Logarithm of the depth shown there over the point's own: above 0 it is seen through."""

    def of(self, rows: Int[Tensor, " chosen"]) -> "Look":
        """Some of the points."""
        return Look(
            self.view, self.x[rows], self.y[rows], self.z[rows], self.inside[rows], self.ratio[rows]
        )

    def bias(self, height: int, width: int) -> Float[Tensor, " point"]:
        """What `ratio` is around each point: the smooth part of both captures' errors of depth.

        Points that disagree with those around them, such as those of what changed, count little
        (Cauchy's weights).
        """
        near = self.inside & (self.ratio.abs() < FAR_OFF)
        place, ratio = self.y[near] * width + self.x[near], self.ratio[near]
        field = torch.zeros(height * width, dtype=torch.float64)
        for _ in range(FITS):
            weights = 1 / (1 + ((ratio - field[place]) / NOISE) ** 2)
            sums = [
                torch.zeros_like(field).index_add_(0, place, each).view(height, width).numpy()
                for each in (weights * ratio, weights)
            ]
            part, whole = (torch.from_numpy(gaussian_filter(each, SMOOTH * width)) for each in sums)
            field = (part / (whole + LITTLE)).flatten()
        return field[self.y * width + self.x]


@torch.no_grad()
def eyes_of(scene: "Scene") -> Eyes:
    """What the cameras of a scene show."""
    drawn = scene.render(ids=True)
    assert drawn.ids is not None
    colors = weighted_lab(drawn.colors.permute(0, 2, 3, 1))
    return Eyes(scene, drawn.depths.double(), colors, drawn.ids)
