"""Small curves side by side in one PNG, for figures of benchmarks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

WIDTH, HEIGHT = 240, 220
"""Of a panel, pixels."""
LEFT, TOP, RIGHT, BOTTOM = 30, 40, 210, 190
"""The frame of the curves in it."""
COLORS = ("red", "blue", "green", "orange", "purple", "black", "brown")

Row = Mapping[str, float]


@dataclass(frozen=True)
class Panel:
    """One figure over another."""

    name: str
    """Of the figure in the rows."""
    bounds: tuple[float, float] | None = None
    """None: an axis in powers of ten around what was measured."""


def draw_panels(
    curves: Mapping[str, Sequence[Row]], across: str, panels: Sequence[Panel], file: Path
) -> None:
    """A panel for each figure, a curve for each name; the axis across is in powers of ten.

    Args:
        curves: Rows by the name of the curve; a row may lack a figure.
        across: Name of the figure of the horizontal axis.
        panels: From left to right.
        file: A PNG.
    """
    names = list(curves)
    legend_rows = -(-len(names) // 2)
    picture = Image.new("RGB", (len(panels) * WIDTH, HEIGHT + 14 * legend_rows), "white")
    draw = ImageDraw.Draw(picture)
    every = np.log10([row[across] for rows in curves.values() for row in rows])
    for number, panel in enumerate(panels):
        corner = number * WIDTH
        shown = {name: [row for row in rows if row.get(panel.name) is not None]
                 for name, rows in curves.items()}  # fmt: skip
        low, high = panel.bounds or _powers(
            [r[panel.name] for rows in shown.values() for r in rows]
        )
        draw.rectangle([corner + LEFT, TOP, corner + RIGHT, BOTTOM], outline="gray")
        unit = "" if panel.bounds else "10^"
        draw.text((corner + LEFT, TOP - 14), f"{panel.name}, {unit}{low:g} to {unit}{high:g}",
                  fill="black")  # fmt: skip
        draw.text((corner + LEFT, BOTTOM + 2), f"{across}, {10 ** every.min():.3g} to "
                  f"{10 ** every.max():.3g}", fill="gray")  # fmt: skip
        for place, name in enumerate(names):
            color = COLORS[place % len(COLORS)]
            values = np.array([row[panel.name] for row in shown[name]], float)
            up = values if panel.bounds else np.log10(values.clip(1e-9))
            along = np.log10([row[across] for row in shown[name]])
            x = corner + LEFT + (RIGHT - LEFT) * (along - every.min()) / max(np.ptp(every), 1e-9)
            y = BOTTOM - (BOTTOM - TOP) * (up - low) / max(high - low, 1e-9)
            points = list(zip(x.tolist(), y.clip(TOP, BOTTOM).tolist(), strict=True))
            draw.line(points, fill=color, width=2)
            for left, top in points:
                draw.ellipse((left - 3, top - 3, left + 3, top + 3), fill=color)
            spot = (corner + LEFT + 100 * (place % 2), BOTTOM + 16 + 14 * (place // 2))
            draw.text(spot, name, fill=color)
    picture.save(file)


def _powers(values: Sequence[float]) -> tuple[float, float]:
    logs = np.log10(np.array(values, float).clip(1e-9))
    return float(np.floor(logs.min())), float(np.ceil(logs.max()))
