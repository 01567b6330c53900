"""`instok3d export`: a scene as files that other programs open."""

from pathlib import Path
from typing import Annotated, Literal

import tyro


def run(
    scene: tyro.conf.Positional[Path],
    /,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    per_object: Path | None = None,
    format: str | None = None,
    sh: Literal[0, 1, 2, 3] = 3,
    only: str | None = None,
    with_ids: bool = False,
    up: tuple[str, ...] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a scene for other programs; docs/formats.md says what each format keeps.

    Hidden objects are left out.

    Args:
        scene: A scene folder.
        output: A file of Gaussians, whose ending says which format (.ply, .compressed.ply, .spz,
            .splat, .ksplat, .sog, .glb, .usdz); .html, a page that shows the scene in any browser;
            or what --format makes.
        per_object: A folder for a PLY, a convex hull and a thumbnail of each object, with their
            boxes in index.json.
        format: Instead of Gaussians: "colmap" (a folder with a model of the photos' cameras),
            "nerfstudio" (a transforms.json), "masks" (a folder with 16-bit id PNGs and COCO
            instances), "colliders" (convex hulls, .glb or .json), "boxes" (.glb), "ros" (a .json
            like Detection3DArray).
        sh: Degree of the colours. Bands that the scene lacks are zeros: many viewers read only
            degree 0 and 3.
        only: Id, key or label of one object to write alone; in a scene with semantics also words
            such as "the red chair", or "all chairs" for several.
        with_ids: Add a last column object_id (0: no object) to a PLY; some viewers refuse it.
        up: An axis such as z (-y: --up=-y), or x y z: up for this command. `instok3d edit SCENE up`
            sets it for good.
        overwrite: Replace files that are already there.
    """
    from instok3d.cli.targets import check_target, load_scene, objects_by_words
    from instok3d.formats.layouts import check_layout, write_layout
    from instok3d.formats.object_folder import write_object_folder
    from instok3d.formats.parts import only_objects
    from instok3d.formats.registry import ExportOptions, export_scene, format_of

    if output is None and per_object is None:
        raise ValueError("nothing to write: give a file with -o, or a folder with --per-object")
    if format is not None and output is None:
        raise ValueError(f"--format {format} needs a file or folder to write: give it with -o")
    if output is not None:
        if format is None:
            format_of(output, to_write=True)
        folder = format is not None and not check_layout(format, output).suffixes
        check_target(output, overwrite=overwrite, folder=folder)
    if per_object is not None:
        check_target(per_object, overwrite=overwrite, folder=True)
    whole = load_scene(scene, up)
    loaded = whole.drawn() if only is None else only_objects(whole, objects_by_words(whole, only))
    options = ExportOptions(sh_degree=sh, with_ids=with_ids, overwrite=overwrite)
    if format is not None and output is not None:
        write_layout(format, output, loaded, overwrite=overwrite)
        print(f"{format} of {len(loaded.objects)} objects written to {output}")
    elif output is not None:
        export_scene(loaded, output, options)
        print(f"{len(loaded.gaussians.means)} Gaussians written to {output}")
    if per_object is not None:
        write_object_folder(per_object, loaded, options)
        print(f"{len(loaded.objects)} objects written to {per_object}")
