"""Masks in little room: the uncompressed run lengths of COCO."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from instok3d.reading import whole_number
from instok3d.scene.picture_size import MAX_PICTURE_PIXELS


@dataclass(frozen=True)
class RunLengths:
    """A mask of one view."""

    height: int
    """Pixels."""
    width: int
    counts: tuple[int, ...]
    """Lengths of the runs down the columns, the first column first; the first run is outside of the
    mask, and 0 long where the mask begins with a pixel of its own."""

    @staticmethod
    def of(mask: Bool[Tensor, "height width"]) -> "RunLengths":
        """The run lengths of a mask."""
        height, width = mask.shape
        flat = mask.cpu().numpy().T.reshape(-1)
        changes = np.flatnonzero(np.diff(flat)) + 1
        runs = np.diff(np.concatenate([[0], changes, [flat.size]])).tolist()
        begins_inside = flat.size > 0 and bool(flat[0])
        return RunLengths(height, width, (0, *runs) if begins_inside else tuple(runs))

    @property
    def area(self) -> int:
        """Pixels of the mask."""
        return sum(self.counts[1::2])

    def mask(self) -> Bool[Tensor, "height width"]:
        """The mask itself."""
        inside = np.arange(len(self.counts)) % 2 == 1
        flat = np.repeat(inside, self.counts).reshape(self.width, self.height)
        return torch.from_numpy(np.ascontiguousarray(flat.T))

    def box(self) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 around the pixels, exclusive at the end; zeros for an empty mask."""
        y, x = self.mask().nonzero(as_tuple=True)
        if not len(x):
            return 0, 0, 0, 0
        return int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1

    def meets_frame(self) -> bool:
        """Whether a pixel of the mask lies on the border of the view."""
        x0, y0, x1, y1 = self.box()
        return self.area > 0 and (x0 == 0 or y0 == 0 or x1 == self.width or y1 == self.height)

    def to_json(self) -> dict[str, Any]:
        """COCO's segmentation."""
        return {"size": [self.height, self.width], "counts": list(self.counts)}

    @staticmethod
    def from_json(value: Any) -> "RunLengths":
        """The mask of COCO's segmentation; nothing is allocated for its pixels.

        Raises:
            KeyError, TypeError, ValueError: It is of another form, or the runs do not fill it.
        """
        height, width = (whole_number(each, 1) for each in value["size"])
        counts = tuple(whole_number(each) for each in value["counts"])
        if height * width > MAX_PICTURE_PIXELS or sum(counts) != height * width:
            raise ValueError(f"runs of {sum(counts)} pixels are no mask of {height} x {width}")
        return RunLengths(height, width, counts)
