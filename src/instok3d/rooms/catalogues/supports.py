"""Where things may stand on a model: the level areas that are seen from above."""

import numpy as np
from jaxtyping import Bool, Float

from instok3d.rooms.objects.base import Support
from instok3d.rooms.primitives import Part
from instok3d.rooms.tracing import EmbreeTracer

CELL_M = 0.02
MARGIN_M = 0.02
"""Kept free at the border of a surface."""
LEVEL_M = 0.006
"""A surface is level where its heights differ by no more."""
ROUGH_M = 0.03
"""Added to it for cushions."""
LEAST_SIDE_M = 0.14
MOST_HEIGHT_M = 1.5
"""Nothing is put on what is higher."""
LEAST_HEIGHT_M = 0.15
MOST_SUPPORTS = 2


def level_supports(parts: tuple[Part, ...], rough_m: float = 0.0) -> tuple[Support, ...]:
    """Rectangles that are level and have nothing of the model above them, two at most.

    Rays from above give the height of every cell of a grid over the footprint; a surface is a
    height that many cells share, its support the largest rectangle of such cells.

    Args:
        parts: Of a model that stands on the floor, z = 0.
        rough_m: By how much more than hard surfaces these may be uneven.

    Raises:
        ModuleNotFoundError: The ray tracer is not installed.
    """
    tolerance_m = LEVEL_M + rough_m
    heights, low = _heights(parts)
    found: list[Support] = []
    for _ in range(MOST_SUPPORTS):
        usable = heights[(heights >= LEAST_HEIGHT_M) & (heights <= MOST_HEIGHT_M)]
        if not len(usable):
            break
        counts = np.bincount(np.rint(usable / tolerance_m).astype(np.int64))
        level = counts.argmax() * tolerance_m
        mask = np.abs(heights - level) <= tolerance_m
        row, column, rows, columns = _largest_rectangle(mask)
        z = float(heights[row : row + rows, column : column + columns].max(initial=0.0))
        x0, y0 = low + CELL_M * np.array([column, row]) + MARGIN_M
        x1, y1 = low + CELL_M * np.array([column + columns, row + rows]) - MARGIN_M
        if min(x1 - x0, y1 - y0) < LEAST_SIDE_M:
            break
        found.append(Support(float(x0), float(y0), float(x1), float(y1), z))
        heights = np.where(mask, -np.inf, heights)
    return tuple(found)


def _heights(
    parts: tuple[Part, ...],
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "2"]]:
    """Height of the topmost surface in every cell (-inf where there is none), and the corner."""
    vertices = np.concatenate([part.vertices for part in parts])
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    faces = np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=True)])
    low, high = vertices.min(0), vertices.max(0)
    columns, rows = np.maximum(((high - low)[:2] / CELL_M).astype(int), 1)
    x = low[0] + CELL_M * (np.arange(columns) + 0.5)
    y = low[1] + CELL_M * (np.arange(rows) + 0.5)
    above = np.float32(high[2] + 1)
    origins = np.stack([*np.meshgrid(x, y), np.full((rows, columns), above)], -1).reshape(-1, 3)
    down = np.tile(np.array([0, 0, -1], np.float32), (len(origins), 1))
    hits = EmbreeTracer(vertices, faces).trace(origins.astype(np.float32), down)
    heights = np.where(hits.face >= 0, above - hits.distance, -np.inf)
    return heights.reshape(rows, columns).astype(np.float64), low[:2].astype(np.float64)


def _largest_rectangle(mask: Bool[np.ndarray, "row column"]) -> tuple[int, int, int, int]:
    """First row and column, rows and columns of the largest rectangle that is all true."""
    best = (0, 0, 0, 0)
    run = np.zeros(mask.shape[1], int)  # true cells upwards from the current row
    for row in range(mask.shape[0]):
        run = np.where(mask[row], run + 1, 0)
        for height in np.unique(run[run > 0]):
            start, length = _longest_run(run >= height)
            if height * length > best[2] * best[3]:
                best = (row - int(height) + 1, start, int(height), length)
    return best


def _longest_run(mask: Bool[np.ndarray, " cell"]) -> tuple[int, int]:
    """Start and length of the longest run of true cells."""
    steps = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    starts, ends = np.nonzero(steps == 1)[0], np.nonzero(steps == -1)[0]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest] - starts[longest])
