"""Contact sheets: what the model sees, should show, and shows."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw
from torch import Tensor

GAP = 4
TITLE = 14
"""Height of the line of titles, pixels."""


def contact_sheet(
    rows: Sequence[Sequence[np.ndarray]], titles: Sequence[str], *, min_cell: int = 128
) -> Image.Image:
    """Pictures of one size in rows, with a title over each column.

    Args:
        rows: [height, width, 3] uint8 pictures.
        titles: One for each column.
        min_cell: Smaller pictures are enlarged to at least this height by a whole factor.
    """
    height, width = rows[0][0].shape[:2]
    factor = max(1, -(-min_cell // height))
    height, width = height * factor, width * factor
    columns = max(len(row) for row in rows)
    size = (columns * (width + GAP) + GAP, len(rows) * (height + GAP) + GAP + TITLE)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for column, title in enumerate(titles):
        draw.text((GAP + column * (width + GAP), 1), title, fill=(32, 32, 32))
    for y, row in enumerate(rows):
        for x, picture in enumerate(row):
            cell = Image.fromarray(picture).resize((width, height), Image.Resampling.NEAREST)
            sheet.paste(cell, (GAP + x * (width + GAP), TITLE + GAP + y * (height + GAP)))
    return sheet


def color_picture(
    image: Float[Tensor, "3 height width"],
) -> UInt8[np.ndarray, "height width 3"]:
    """An sRGB image in [0, 1] as bytes; values outside are cut."""
    cut = (image.detach().float().clamp(0, 1) * 255).round().to(torch.uint8)
    return cut.permute(1, 2, 0).contiguous().cpu().numpy()


def id_picture(ids: Int[Tensor, "height width"]) -> UInt8[np.ndarray, "height width 3"]:
    """One colour for each id > 0; black for 0, dark grey for what is ignored (-1)."""
    count = max(int(ids.max()), 0) + 1
    hue = (np.arange(count) * 0.61803) % 1.0
    value = np.where(np.arange(count) % 2, 1.0, 0.75)
    turn = (hue[:, None] * 6 + np.array([0, 4, 2])) % 6
    palette = (value[:, None] * (0.15 + 0.85 * np.clip(np.abs(turn - 3) - 1, 0, 1)) * 255).round()
    palette[0] = 0
    grey = np.full((1, 3), 64)
    return np.concatenate([palette, grey]).astype(np.uint8)[ids.cpu().numpy()]


def depth_picture(
    depths: Float[Tensor, "height width"], *, farthest: float
) -> UInt8[np.ndarray, "height width 3"]:
    """Near is bright, `farthest` and beyond are black, unknown (0) is black too."""
    near = (1 - depths.detach().float() / farthest).clamp(0, 1) * (depths > 0)
    grey = (near * 255).round().to(torch.uint8).cpu().numpy()
    return np.repeat(grey[..., None], 3, axis=-1)
