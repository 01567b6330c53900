"""Connected regions of a picture of numbers.

SciPy has them too, but its import takes a quarter of a second, and no other step of a
reconstruction needs it.
"""

import torch
from jaxtyping import Int
from torch import Tensor


def connected_regions(values: Int[Tensor, "height width"]) -> Int[Tensor, "height width"]:
    """For each pixel the first pixel, in reading order, of its region of one value.

    Pixels are counted row by row from 0. Neighbours above, below, left and right are connected.
    """
    number = torch.arange(values.numel(), device=values.device).view(values.shape)
    beside, below = values[:, :-1] == values[:, 1:], values[:-1] == values[1:]
    a = torch.cat([number[:, :-1][beside], number[:-1][below]])
    b = torch.cat([number[:, 1:][beside], number[1:][below]])
    root = number.flatten()
    while not torch.equal(root[a], root[b]):
        # 1. The root of every region goes below the lowest root that it touches.
        lower, upper = torch.minimum(root[a], root[b]), torch.maximum(root[a], root[b])
        root = root.scatter_reduce(0, upper, lower, "amin")
        # 2. Every pixel points to the root of its region itself.
        while not torch.equal(root[root], root):
            root = root[root]
    return root.view(values.shape)
