"""`instok3d import`: a scene from a file of Gaussians of another program, or from the hub."""

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
    """Make a scene of a file of Gaussians (docs/formats.md says which are read), or of the hub's.

    Objects come from columns of ids, from named parts, from the JSON file that export writes
    beside some formats, or from a folder's files. The scene has no photos.

    Args:
        file: Such a file, or a folder with one PLY for each object; or hub:USER/NAME@REVISION, a
            scene that `instok3d push` pushed, with its photos and edits.
        output: The scene folder to write, such as room.itk.
        match: A scene that the file was exported from, before another program edited it: its
            objects are found again in the file.
        overwrite: Replace a scene that is already there.
    """
    from instok3d.cli.progress import plain_warnings
    from instok3d.formats.importing import import_scene
    from instok3d.hub.references import is_hub
    from instok3d.scene.files import check_target
    from instok3d.scene.previews import save_with_previews
    from instok3d.scene.scene import Scene

    check_target(output, overwrite=overwrite)
    if is_hub(file):
        if match is not None:
            raise ValueError(f"--match goes with files of other programs, {file} is a scene")
        with plain_warnings():
            save_with_previews(scene := Scene.load(file), output, overwrite=overwrite)
        print(f"{scene.provenance.hub}: {len(scene.objects)} objects written to {output}")
        return
    scene = import_scene(file, match=None if match is None else Scene.load(match))
    scene.save(output, overwrite=overwrite)
    for note in scene.warnings:
        print(f"note: {note}")
    count, objects = len(scene.gaussians.means), len(scene.objects)
    print(f"{count} Gaussians and {objects} objects written to {output}")
