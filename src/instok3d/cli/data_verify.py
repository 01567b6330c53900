"""`instok3d data verify`: whether the files of a prepared folder are as they were written."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

FAILED = 2
"""Exit code when files are missing or damaged."""


def verify(
    folder: Positional[Path], json_output: Annotated[bool, arg(name="json")] = False,
    index: bool = False,
) -> int:  # fmt: skip
    """Compare every file of a prepared folder with its checksum; exit code 2 if any is wrong.

    Args:
        folder: Written by `instok3d data prepare`.
        json_output: Print the faults as JSON.
        index: First write the index of scenes anew from what lies in the folder.
    """
    from instok3d.datasets.prepared import refresh_index, scene_folders
    from instok3d.datasets.prepared.verifying import verify_index, verify_scene
    from instok3d.progress import progress_bar

    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    if index:
        refresh_index(folder)
    faults = list(verify_index(folder))
    scenes = scene_folders(folder)
    with progress_bar(len(scenes), unit="scene") as bar:
        for scene in scenes:
            faults += verify_scene(scene)
            bar.update()
    if json_output:
        rows = [asdict(fault) for fault in faults]
        print(json.dumps({"scenes": len(scenes), "faults": rows}, indent=2))
    else:
        for fault in faults:
            print(f"{fault.path}: {fault.problem}")
        print(f"{folder}: {len(scenes)} scenes, {len(faults)} faults")
    return FAILED if faults else 0
