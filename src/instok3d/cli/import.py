"""`instok3d import`: a scene from a file of Gaussians that another program wrote."""

from pathlib import Path
from typing import Annotated

import tyro


def run(
    file: tyro.conf.Positional[Path],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    match: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Make a scene of a file of Gaussians; docs/formats.md says which are read.

    Objects come from columns of ids, from named parts, from the JSON file that export writes
    beside some formats, or from a folder's files. The scene has no photos.

    Args:
        file: Such a file, or a folder with one PLY for each object.
        output: The scene folder to write, such as room.itk.
        match: A scene that the file was exported from, before another program edited it: its
            objects are found again in the file.
        overwrite: Replace a scene that is already there.
    """
    from instok3d.formats.importing import import_scene
    from instok3d.scene.files import check_target
    from instok3d.scene.scene import Scene

    check_target(output, overwrite=overwrite)
    scene = import_scene(file, match=None if match is None else Scene.load(match))
    scene.save(output, overwrite=overwrite)
    for note in scene.warnings:
        print(f"note: {note}")
    count, objects = len(scene.gaussians.means), len(scene.objects)
    print(f"{count} Gaussians and {objects} objects written to {output}")
