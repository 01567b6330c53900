"""Where the surface of one thing goes on as that of another, seen in a view.

Two regions of a picture touch along their common border. Where the depth jumps there, one of them
only hides the other; where it does not, they are parts of one surface or stand on each other.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

DEPTH_STEP = 0.06
"""Relative difference of depth, across the border and one pixel to either side of it, up to which a
surface goes on. Rendered depth is blended over the border itself."""


@dataclass(frozen=True)
class Contacts:
    """Lengths of borders, in pairs of adjacent pixels, summed over views."""

    border: Float[Tensor, "row column"]
    """Of each row's region with each column's."""
    surface: Float[Tensor, "row column"]
    """Of these the pairs across which the surface goes on."""

    def __add__(self, other: "Contacts") -> "Contacts":
        return Contacts(self.border + other.border, self.surface + other.surface)


def find_contacts(
    rows: Int[Tensor, "height width"],
    columns: Int[Tensor, "height width"],
    depths: Float[Tensor, "height width"],
    num_rows: int,
    num_columns: int,
) -> Contacts:
    """The contacts of one view, not differentiable.

    A border is where the column changes. The outermost pixels have no neighbour to compare depth
    with, so borders there do not count.

    Args:
        rows: Region of each pixel; each lies within one column's region.
        columns: The coarser regions that they touch. The same map gives a symmetric answer.
        depths: z-depth, scene units; 0 is nothing, on which no surface goes on.
        num_rows: Regions that there are.
        num_columns: Likewise.
    """
    border = torch.zeros(num_rows * num_columns)
    surface = torch.zeros(num_rows * num_columns)
    for dim in (0, 1):
        if depths.shape[dim] < 4:
            continue
        (outer, first, second, last), (row, other_row), (column, other) = (
            _shifted(depths, dim), _shifted(rows, dim)[1:3], _shifted(columns, dim)[1:3],
        )  # fmt: skip
        at = column != other
        nearest = torch.minimum(outer, last)
        goes_on = (outer - last).abs() <= DEPTH_STEP * nearest
        weight = (goes_on & (torch.minimum(nearest, torch.minimum(first, second)) > 0))[at].float()
        for own, touched in ((row, other), (other_row, column)):
            cell = own[at] * num_columns + touched[at]
            border.index_add_(0, cell, torch.ones_like(weight))
            surface.index_add_(0, cell, weight)
    shape = (num_rows, num_columns)
    return Contacts(border.view(shape), surface.view(shape))


def _shifted(values: Tensor, dim: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Four pixels in a row, of which the middle two are the border's."""
    size = values.shape[dim] - 3
    one, two, three, four = (values.narrow(dim, start, size) for start in range(4))
    return one, two, three, four
