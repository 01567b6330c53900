"""Pictures for people: colours, ids and depth as bytes, and sheets of them with captions."""

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image, ImageDraw
from torch import Tensor

MIN_CELL = 128
"""Height in pixels that smaller pictures are enlarged to on a sheet, by a whole factor."""
GAP = 6
LINE = 16
"""Height of a line of text, pixels."""
INK = (32, 32, 32)
HATCH = (255, 0, 255)
STRIPE = 3
"""Width of a stripe, pixels along a row."""
IGNORED = (64, 64, 64)
"""Colour of pixels without a known id (-1)."""


@cache
def display_color(number: int) -> str:
    """A colour #rrggbb for an id; hues step by the golden ratio, so that neighbours differ."""
    hue = (number * 0.61803398875) % 1.0
    value = (0.95, 0.75, 0.55)[number % 3]
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.75, value)
    return f"#{round(red * 255):02x}{round(green * 255):02x}{round(blue * 255):02x}"


def color_picture(
    images: Float[Tensor, "*view 3 height width"],
) -> UInt8[np.ndarray, "*view height width 3"]:
    """SRGB images in [0, 1] as bytes; values outside are clamped."""
    bytes_ = (images.detach().float().clamp(0, 1) * 255).round().to(torch.uint8)
    return bytes_.movedim(-3, -1).contiguous().cpu().numpy()


def hatched(
    picture: UInt8[np.ndarray, "height width 3"], mask: Bool[np.ndarray, "height width"]
) -> UInt8[np.ndarray, "height width 3"]:
    """The picture with magenta stripes where the mask is, which rooms hardly ever show."""
    y, x = np.indices(mask.shape)
    stripes = np.where(((x + y) // STRIPE % 2 == 0)[..., None], HATCH, picture // 2)
    return np.where(mask[..., None], stripes, picture).astype(np.uint8)


def save_png(picture: Image.Image, path: Path) -> None:
    """Write a PNG with the least compression: a tenth larger, in a third of the time."""
    picture.save(path, "PNG", compress_level=1)


def id_picture(
    ids: Int[Tensor, "*view height width"] | Int[np.ndarray, "*view height width"],
) -> UInt8[np.ndarray, "*view height width 3"]:
    """Each id > 0 in its display colour; 0 is black, -1 (ignored) dark grey."""
    values, inverse = np.unique(torch.as_tensor(ids).cpu().numpy(), return_inverse=True)
    palette = [bytes.fromhex(display_color(int(value))[1:]) for value in values]
    colors = np.array([list(color) for color in palette], np.uint8).reshape(-1, 3)
    colors[values == 0] = 0
    colors[values < 0] = IGNORED
    return colors[inverse.reshape(ids.shape)]


def depth_picture(
    depths: Float[Tensor, "*view height width"], *, farthest: float
) -> UInt8[np.ndarray, "*view height width 3"]:
    """Near is bright; `farthest` and beyond are black, and so is unknown depth (0)."""
    near = (1 - depths.detach().float() / farthest).clamp(0, 1) * (depths > 0)
    grey = (near * 255).round().to(torch.uint8).cpu().numpy()
    return np.repeat(grey[..., None], 3, axis=-1)


@dataclass(frozen=True)
class Section:
    """Some pictures of a contact sheet under a common title."""

    title: str
    """Empty: no line is left for it."""
    cells: Sequence[UInt8[np.ndarray, "height width 3"]]
    labels: Sequence[str] = ()
    """One under each cell, shortened to its width; none: no line is left for them."""


def titled_rows(
    rows: Sequence[Sequence[UInt8[np.ndarray, "height width 3"]]], titles: Sequence[str]
) -> list[Section]:
    """Rows of pictures whose columns have titles, said once, under the first row."""
    return [Section("", row, titles if number == 0 else ()) for number, row in enumerate(rows)]


def contact_sheet(
    sections: Sequence[Section], *, cell_height: int | None = None, columns: int = 8
) -> Image.Image:
    """Sections one below the other, their cells in rows from left to right.

    Args:
        sections: All cells have one size.
        cell_height: In pixels; None takes the smallest whole multiple of the cells' height that
            is at least MIN_CELL.
        columns: The most cells in a row.

    Raises:
        ValueError: No cell in any section.
    """
    cells = [cell for section in sections for cell in section.cells]
    if not cells:
        raise ValueError("a contact sheet needs at least one picture, got none")
    height, width = cells[0].shape[:2]
    tall = height * -(-MIN_CELL // height) if cell_height is None else cell_height
    cell = (round(width * tall / height), tall)
    used = min(columns, max(len(section.cells) for section in sections))
    tops = np.cumsum([GAP, *(_height(section, tall, used) for section in sections)])
    sheet = Image.new("RGB", (GAP + used * (cell[0] + GAP), int(tops[-1])), "white")
    for section, top in zip(sections, tops, strict=False):
        _draw(sheet, section, int(top), cell, used)
    return sheet


def _height(section: Section, cell_height: int, columns: int) -> int:
    rows = -(-len(section.cells) // columns)
    line = LINE if section.labels else 0
    return (LINE if section.title else 0) + rows * (cell_height + line + GAP)


def _draw(
    sheet: Image.Image, section: Section, top: int, cell: tuple[int, int], columns: int
) -> None:
    draw = ImageDraw.Draw(sheet)
    width, height = cell
    if section.title:
        draw.text((GAP, top), section.title, fill=INK)
        top += LINE
    line = LINE if section.labels else 0
    for index, picture in enumerate(section.cells):
        x = GAP + index % columns * (width + GAP)
        y = top + index // columns * (height + line + GAP)
        whole = height % picture.shape[0] == 0
        resampling = Image.Resampling.NEAREST if whole else Image.Resampling.BICUBIC
        sheet.paste(Image.fromarray(picture).resize(cell, resampling), (x, y))
        if section.labels:
            label = section.labels[index]
            text = label if len(label) * 6 <= width else label[: max(width // 6 - 3, 0)] + "..."
            draw.text((x, y + height + 2), text, fill=INK)
