"""`instok3d export`: a scene as a file that other programs open."""

from pathlib import Path
from typing import Annotated, Literal

import tyro


def run(
    scene: tyro.conf.Positional[Path],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    sh: Literal[0, 1, 2, 3] = 3,
    only: str | None = None,
    with_ids: bool = False,
    overwrite: bool = False,
) -> None:
    """Write the Gaussians as a 3DGS PLY, sorted by object.

    The rows of each object are the gaussian_range in the scene's objects.json.

    Args:
        scene: A scene folder.
        output: A file that ends in .ply.
        sh: Degree of the colours. Bands that the scene lacks are zeros: many viewers read only
            degree 0 and 3.
        only: Id or key of one object to write alone.
        with_ids: Add a last column object_id (0: no object); some viewers refuse it.
        overwrite: Replace a file that is already there.
    """
    from dataclasses import replace

    from instok3d.cli.targets import check_file, object_name
    from instok3d.scene.ply import scene_comments, write_ply
    from instok3d.scene.scene import Scene

    check_file(output, overwrite=overwrite, endings=(".ply",))
    loaded = Scene.load(scene) if only is not None else Scene.load(scene).drawn()
    ids = loaded.object_ids()
    if only is not None:
        item = loaded.object(object_name(only))
        start, count = item.gaussian_range
        loaded = replace(loaded, gaussians=loaded.part(item.id))
        ids = ids[start : start + count]
    write_ply(
        output, loaded.gaussians, sh_degree=sh, object_ids=ids if with_ids else None,
        comments=scene_comments(loaded), overwrite=overwrite,
    )  # fmt: skip
    print(f"{len(loaded.gaussians.means)} Gaussians written to {output}")
