"""`instok3d demo`: from nothing to a scene with what comes in the package."""

from pathlib import Path
from typing import Annotated

import tyro


def run(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("demo.itk"),
    overwrite: bool = False,
    json: bool = False,
    timings: bool = False,
) -> None:
    """Reconstruct the photos of a rendered room that come with the package.

    Args:
        output: The scene folder to write.
        overwrite: Replace a scene that is already there.
        json: Print the result as one JSON object on stdout.
        timings: Print how long each stage took, on stderr.
    """
    from instok3d.cli.reconstruct import make_scene
    from instok3d.scene.demo import demo_photos

    with demo_photos() as photos:
        make_scene(photos, output, overwrite=overwrite, json=json, timings=timings)
