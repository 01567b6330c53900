"""Curves of a run as one PNG, drawn with Pillow alone."""

import math
from pathlib import Path

from PIL import Image, ImageDraw

from instok3d.files import replacing
from instok3d.training.run_log import read_metrics

PANEL = (360, 200)
"""Width and height of one figure's panel, pixels."""
MARGIN = 28
COLORS = {"train": (31, 119, 180), "validation": (214, 39, 40)}
NOT_DRAWN = {"kind", "step", "elapsed_s"}


def plot_curves(metrics: Path, output: Path) -> None:
    """One panel for each figure of a metrics.jsonl over steps; training blue, validation red."""
    curves: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for line in read_metrics(metrics):
        for name in line.keys() - NOT_DRAWN:
            if math.isfinite(line[name]):
                points = curves.setdefault(name, {}).setdefault(line["kind"], [])
                points.append((float(line["step"]), float(line[name])))
    names = sorted(curves, key=lambda name: ("validation" not in curves[name], name))
    columns = 4
    rows = max(1, -(-len(names) // columns))
    picture = Image.new("RGB", (columns * PANEL[0], rows * PANEL[1]), "white")
    draw = ImageDraw.Draw(picture)
    for place, name in enumerate(names):
        corner = (place % columns * PANEL[0], place // columns * PANEL[1])
        _panel(draw, corner, name, curves[name])
    with replacing(output) as part:
        picture.save(part)


def _panel(
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    name: str,
    curves: dict[str, list[tuple[float, float]]],
) -> None:
    points = [point for curve in curves.values() for point in curve]
    last_step = max(1.0, max(step for step, _ in points))
    low, high = min(v for _, v in points), max(v for _, v in points)
    span = high - low or 1.0
    left, top = corner[0] + MARGIN, corner[1] + MARGIN
    width, height = PANEL[0] - 2 * MARGIN, PANEL[1] - 2 * MARGIN
    draw.rectangle([left, top, left + width, top + height], outline=(200, 200, 200))
    draw.text((left, top - 14), f"{name}: {points[-1][1]:.4g}", fill=(0, 0, 0))
    draw.text((left + 3, top + 1), f"{high:.3g}", fill=(120, 120, 120))
    draw.text((left + 3, top + height - 12), f"{low:.3g}", fill=(120, 120, 120))
    draw.text((left + width - 40, top + height + 3), f"{last_step:.0f}", fill=(120, 120, 120))
    for kind, curve in curves.items():
        places = [
            (left + width * step / last_step, top + height * (1 - (value - low) / span))
            for step, value in curve
        ]
        if len(places) > 1:
            draw.line(places, fill=COLORS[kind], width=2)
        else:
            x, y = places[0]
            draw.ellipse([x - 2, y - 2, x + 2, y + 2], fill=COLORS[kind])
