"""Pictures that show at a glance what is in a scene."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw
from torch import Tensor

from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene

CELL = 160
"""Height of a picture on the contact sheet, pixels."""
GAP = 6
LABEL = 16
"""Height of a line of text, pixels."""
COLUMNS = 8
INK = (32, 32, 32)


def write_previews(scene: Scene, folder: Path) -> None:
    """Write contact_sheet.png and objects/NNN.png, one for each object, into a folder.

    The sheet has the inputs, the scene rendered at the inputs, the objects' pixels coloured, and
    a tile for each object: it alone, in the view that shows most of it.
    """
    tiles = [object_picture(scene, item) for item in scene.objects]
    (folder / "objects").mkdir(parents=True, exist_ok=True)
    for item, tile in zip(scene.objects, tiles, strict=True):
        Image.fromarray(tile).save(folder / "objects" / f"{item.id:03d}.png")
    _contact_sheet(scene, tiles).save(folder / "contact_sheet.png")


def object_picture(scene: Scene, item: SceneObject) -> UInt8[np.ndarray, "height width 3"]:
    """One object alone on white, from the input view that shows most of it."""
    picture = scene.render([item.best_view.view], only=item.id, background=(1.0, 1.0, 1.0))
    return to_uint8(picture.colors)[0]


def colored_ids(
    scene: Scene, ids: Int[Tensor, "view height width"]
) -> UInt8[np.ndarray, "view height width 3"]:
    """Id maps in the objects' display colours; black where no object is."""
    size = max([item.id for item in scene.objects], default=0) + 1
    palette = np.zeros((size, 3), np.uint8)
    for item in scene.objects:
        palette[item.id] = list(bytes.fromhex(item.color[1:]))
    return palette[ids.cpu().numpy()]


def to_uint8(
    colors: Float[Tensor, "view 3 height width"],
) -> UInt8[np.ndarray, "view height width 3"]:
    """Pictures that can be written, from sRGB in [0, 1]; values outside are cut."""
    cut = (colors.detach().clamp(0, 1) * 255).round().to(torch.uint8)
    return cut.permute(0, 2, 3, 1).contiguous().cpu().numpy()


@torch.no_grad()
def _contact_sheet(scene: Scene, tiles: list[np.ndarray]) -> Image.Image:
    pictures = scene.render(ids=True)
    assert pictures.ids is not None
    photos = scene.photos.cpu().numpy()
    colors = colored_ids(scene, pictures.ids)
    mixed = (0.35 * photos + 0.65 * colors).astype(np.uint8)
    numbers = [f"{index} {view.file}" for index, view in enumerate(scene.views)]
    keys = [f"{item.key} {item.num_gaussians}" for item in scene.objects]
    sections = [
        ("photos", list(photos), numbers),
        ("scene at the photos' cameras", list(to_uint8(pictures.colors)), numbers),
        (f"{len(scene.objects)} objects", list(mixed), numbers),
        ("each object alone, with its number of Gaussians", tiles, keys),
    ]
    width = round(scene.width * CELL / scene.height)
    rows = [max(1, -(-len(cells) // COLUMNS)) for _, cells, _ in sections]
    columns = min(COLUMNS, max(len(scene.views), len(tiles), 3))
    row_height = CELL + LABEL + GAP
    size = (
        GAP + columns * (width + GAP),
        GAP + sum(LABEL + count * row_height for count in rows),
    )
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    top = GAP
    for (title, cells, labels), count in zip(sections, rows, strict=True):
        draw.text((GAP, top), title, fill=INK)
        for index, (cell, label) in enumerate(zip(cells, labels, strict=True)):
            x = GAP + index % COLUMNS * (width + GAP)
            y = top + LABEL + index // COLUMNS * row_height
            sheet.paste(Image.fromarray(cell).resize((width, CELL)), (x, y))
            text = label if len(label) * 6 <= width else label[: width // 6 - 3] + "..."
            draw.text((x, y + CELL + 2), text, fill=INK)
        top += LABEL + count * row_height
    return sheet
