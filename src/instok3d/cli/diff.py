"""`instok3d diff`: what changed between two captures of one room."""

from pathlib import Path

import tyro


def run(
    before: tyro.conf.Positional[Path],
    after: tyro.conf.Positional[Path],
    /,
    json: bool = False,
    seed: int = 0,
) -> None:
    """Print which objects of a room moved, are gone, or are new from one scene to another.

    The scenes are aligned on the objects that they share; where no alignment can be trusted the
    command says so and ends with exit code 2. docs/queries.md has what can be told and what not.

    Args:
        before: A scene folder.
        after: A scene folder of the same room, from other photos.
        json: Print one JSON object.
        seed: Of the search for the alignment.
    """
    from instok3d.cli.info import print_json
    from instok3d.scene.changes.differences import find_differences
    from instok3d.scene.scene import Scene

    found = find_differences(Scene.load(before), Scene.load(after), seed=seed)
    if json:
        print_json({"before": str(before), "after": str(after), **found.to_json()})
    else:
        print(found)
