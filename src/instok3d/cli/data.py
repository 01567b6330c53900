"""`instok3d data`: make procedural rooms and look at them, prepare, verify and label real data."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import tyro

COMMANDS = {
    "rooms": "render procedural rooms into a folder",
    "preview": "a contact sheet of a folder of rooms",
    "prepare": "bring a data set into a folder that training reads",
    "verify": "compare every file of a prepared folder with its checksum",
    "masks": "find things in clips and follow them: ids where there are none",
}
"""Subcommands of `instok3d data`."""


def subcommand(name: str) -> Callable[..., int | None]:
    """One of COMMANDS."""
    if name == "masks":
        from instok3d.cli.data_masks import masks

        return masks
    if name == "prepare":
        from instok3d.cli.data_prepare import prepare

        return prepare
    if name == "verify":
        from instok3d.cli.data_verify import verify

        return verify
    return {"rooms": rooms, "preview": preview}[name]


def _seed_range(text: str) -> range:
    first, separator, end = text.partition(":")
    if not separator or not first.isdecimal() or not end.isdecimal() or int(first) >= int(end):
        raise ValueError(f"--seeds {text!r} is no range; write first:last+1, such as 0:2000")
    return range(int(first), int(end))


def rooms(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    seeds: str = "0:2000",
    resolution: int = 128,
    workers: int = 2,
    level: Literal["mix", "easy", "medium", "hard", "real"] = "mix",
    furniture: Path | None = None,
    textures: Path | None = None,
) -> None:
    """Render procedural rooms into a folder; run it again to resume or to add seeds.

    Training seeds start at 0, validation at 1000000, test at 2000000, transfer at 3000000.
    Whole shards of 16 seeds are made.

    Args:
        output: Folder of shards; made if it is not there.
        seeds: First seed, colon, last seed plus one.
        resolution: Height and width of the pictures, pixels.
        workers: Processes; one a free core.
        level: How hard the rooms are; mix is 30 % easy, 50 % medium, 20 % hard. Rooms of level real
            look like photos: darker, cluttered, finely textured, in mixed light.
        furniture: Folder of models, catalog.json and GLB files, of which about a third of the
            furniture is then made. Who made them is written to CREDITS.txt in the folder.
        textures: Folder of textures, catalog.json and JPEG or PNG files, for half of the floors,
            walls and woods.
    """
    from instok3d.rooms.catalogues.opened import Catalogues
    from instok3d.rooms.generate import generate_rooms

    catalogues = Catalogues.open(furniture, textures)
    for line in catalogues.summary():
        print(line)
    report = generate_rooms(
        output,
        _seed_range(seeds),
        resolution=resolution,
        level=level,
        workers=workers,
        catalogues=catalogues,
    )
    print(
        f"{output}: {report.scenes} new rooms, {report.rejected} seeds rejected, "
        f"{report.skipped} seeds already there"
    )


def preview(
    folder: tyro.conf.Positional[Path],
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    scenes: int = 6,
    views: int = 8,
) -> None:
    """Write a contact sheet of a folder of rooms: colours, instances, depth.

    Args:
        folder: Made by `instok3d data rooms`.
        output: PNG file, replaced if it is there; preview.png in the folder unless given.
        scenes: Rooms, spread over the folder.
        views: Frames of each, spread over its path.
    """
    from instok3d.cli.targets import check_file
    from instok3d.files import replacing
    from instok3d.rooms import RoomDataset
    from instok3d.rooms.preview import rooms_sheet

    path = folder / "preview.png" if output is None else output
    dataset = RoomDataset(folder)
    check_file(path, overwrite=True, endings=(".png",))
    sheet = rooms_sheet(dataset, scenes, views)
    with replacing(path) as part:
        sheet.save(part, "PNG")
    print(path)
