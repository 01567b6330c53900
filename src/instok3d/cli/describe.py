"""`instok3d describe`: a scene in a few words."""

from pathlib import Path

import tyro


def run(
    scene: tyro.conf.Positional[Path],
    /,
    json: bool = False,
    most: int = 60,
    scale: str = "none",
    up: tuple[str, ...] | None = None,
) -> None:
    """Print a scene as a short text: its objects, their sizes, colours, and what stands where.

    Made to be read by people and by language models. docs/queries.md has what is said and how.

    Args:
        scene: A scene folder.
        json: Print one JSON object; the text is in it.
        most: Only so many objects, the largest ones.
        scale: known:OBJECT=HEIGHT gives lengths in metres by one known height in metres, such as
            known:3=0.74. Scenes with cameras in metres need none.
        up: An axis such as z (-y: --up=-y), or x y z: up for this command.
    """
    from instok3d.cli.info import print_json
    from instok3d.cli.targets import load_scene
    from instok3d.formats.objects import find_scale

    loaded = load_scene(scene, up)
    described = loaded.describe(find_scale(loaded, scale), most=most)
    if json:
        print_json({"scene": str(scene), **described.to_json()})
    else:
        print(described)
