"""Pictures that show at a glance what is in a scene."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from instok3d.files import replacing_folder
from instok3d.pictures import Section, color_picture, contact_sheet, id_picture, save_png
from instok3d.scene.object_pictures import object_in_photo, object_picture
from instok3d.scene.objects import SceneObject, counted
from instok3d.scene.paths import orbit
from instok3d.scene.scene import Scene

CELL = 160
"""Height of a picture on the contact sheet, pixels."""
AROUND = 4
"""Pictures of a scene without input views on the sheet."""


def save_with_previews(
    scene: Scene,
    path: Path,
    *,
    overwrite: bool = False,
    progress: Callable[[str], None] | None = None,
) -> None:
    """`Scene.save`, with pictures of the scene and of its objects in previews/.

    Args:
        scene: What to write.
        path: The folder, such as room.itk.
        overwrite: Replace a scene that is already there.
        progress: Called with the name of each stage as it begins; behind a colon, with how far
            it is.

    Raises:
        FileExistsError, FileNotFoundError, PermissionError: As `Scene.save`.
    """
    begin = progress or (lambda stage: None)

    def previews(folder: Path) -> None:
        write_previews(scene, folder / "previews", progress=begin)
        begin("save")

    scene.save(path, overwrite=overwrite, more=previews)


def write_previews_anew(scene: Scene, path: Path) -> None:
    """Exchange the previews of a scene folder, if it has some, for those of an edited scene."""
    if (path / "previews").is_dir():
        with replacing_folder(path / "previews") as folder:
            inputs = path / "previews" / "inputs"
            if inputs.is_dir():  # the photos of a scene folder of version 1
                shutil.copytree(inputs, folder / "inputs")
            write_previews(scene, folder, progress=lambda stage: None)


def write_previews(scene: Scene, folder: Path, progress: Callable[[str], None]) -> None:
    """Write contact_sheet.png and objects/NNN.png, one for each object, into a folder.

    The sheet has the inputs, the scene rendered at the inputs, the objects' pixels coloured, and
    for each object its part of the photo that shows most of it, and it alone (`object_pictures`);
    fragments behind all others.
    """
    tiles = []
    for number, item in enumerate(scene.objects, 1):
        progress(f"previews: object {number} of {len(scene.objects)}")
        tiles.append(object_picture(scene, item))
    progress("previews: contact sheet")
    (folder / "objects").mkdir(parents=True, exist_ok=True)
    for item, tile in zip(scene.objects, tiles, strict=True):
        save_png(Image.fromarray(tile), folder / "objects" / f"{item.id:03d}.png")
    save_png(scene_sheet(scene, scene.objects, tiles), folder / "contact_sheet.png")


@torch.no_grad()
def scene_sheet(
    scene: Scene, objects: Sequence[SceneObject], tiles: Sequence[np.ndarray]
) -> Image.Image:
    """Photos, renders, ids, and two pictures of each of some objects on one sheet.

    Args:
        scene: Any; of one without photos each object has one picture.
        objects: Some of it.
        tiles: Each of them alone (`object_picture`).
    """
    cameras = scene.cameras if scene.views else orbit(scene, AROUND)
    pictures = scene.render(cameras, scene.height, scene.width, ids=True)
    assert pictures.ids is not None
    photos = scene.photos.cpu().numpy()
    behind = photos if scene.views else color_picture(pictures.colors)
    mixed = (0.35 * behind + 0.65 * id_picture(pictures.ids)).astype(np.uint8)
    names = [view.file for view in scene.views] or ["around"] * AROUND
    numbers = [f"{index} {name}" for index, name in enumerate(names)]
    shown = list(zip(objects, tiles, strict=True))
    whole = [(item, tile) for item, tile in shown if not item.is_fragment]
    fragments = [(item, tile) for item, tile in shown if item.is_fragment]
    sections = [
        Section("photos", list(photos), numbers),
        Section(
            "scene at the photos' cameras" if scene.views else "scene from around",
            list(color_picture(pictures.colors)), numbers,
        ),
        Section(counted(scene.objects), list(mixed), numbers),
        Section(
            "each object in a photo, with its number of Gaussians, and alone",
            *_object_cells(scene, whole),
        ),
        Section(
            "fragments: likely pieces of things, small and unsure",
            *_object_cells(scene, fragments),
        ),
    ]  # fmt: skip
    return contact_sheet([each for each in sections if each.cells], cell_height=CELL)


def _object_cells(
    scene: Scene, shown: Sequence[tuple[SceneObject, np.ndarray]]
) -> tuple[list[np.ndarray], list[str]]:
    """Pictures of objects, in a photo where one shows them and alone, and what is written below."""
    cells, keys = [], []
    for item, tile in shown:
        seen = object_in_photo(scene, item)
        cells += [tile] if seen is None else [seen, tile]
        key = f"{item.key} {item.num_gaussians}"
        keys += [key] if seen is None else [key, "alone"]
    return cells, keys
