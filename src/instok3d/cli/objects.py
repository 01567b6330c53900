"""`instok3d objects`: the objects of a scene as data."""

from pathlib import Path

import tyro


def run(
    scene: tyro.conf.Positional[Path],
    /,
    json: bool = False,
    csv: bool = False,
    scale: str = "none",
    up: tuple[str, ...] | None = None,
) -> None:
    """Print the objects of a scene: names, boxes, sizes, and the views that show them.

    Args:
        scene: A scene folder.
        json: Print one JSON object with masks, by the schema assets/objects.schema.json.
        csv: Print a table; this is also what is printed when nothing is said.
        scale: known:OBJECT=HEIGHT gives lengths in metres by one known height in metres, such as
            known:3=0.74. Scenes with cameras in metres need none.
        up: An axis such as z (-y: --up=-y), or x y z: up for this command. `instok3d edit SCENE up`
            sets it for good.
    """
    from instok3d.cli.info import print_json
    from instok3d.cli.targets import load_scene
    from instok3d.formats.objects import find_scale, objects_csv
    from instok3d.scene.object_list import objects_document

    if json and csv:
        raise ValueError("--json and --csv are two ways to print the same: give one of them")
    loaded = load_scene(scene, up)
    found = find_scale(loaded, scale)
    if json:
        print_json(objects_document(loaded, found, loaded.neighbours()))
    else:
        print(objects_csv(loaded, found), end="")
