"""What a file of Gaussians cannot say itself, in a JSON file beside it: frame, units, objects."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from instok3d.files import sha256_of, write_json
from instok3d.formats.splats import Splats
from instok3d.formats.statements import scene_comments, stated_units, stated_up
from instok3d.reading import naming_damage, read_json, text, whole_number
from instok3d.scene.scene import Scene

FORMAT = "instok3d-sidecar-1"
REMEDY = "remove it, and the file is read without objects"


def sidecar_path(path: Path) -> Path:
    """Where the sidecar of a file lies: room.spz.json for room.spz."""
    return path.with_name(path.name + ".json")


def check_sidecar(path: Path, *, overwrite: bool) -> None:
    """Fail before a file is written if its sidecar could not be.

    Raises:
        FileExistsError: Something is in the sidecar's place, and overwrite is off or it is none.
    """
    file = sidecar_path(path)
    if not file.exists():
        return
    if not overwrite:
        raise FileExistsError(f"{file} is already there; pass --overwrite to replace it")
    try:
        value = read_json(file, REMEDY) if file.is_file() else None
    except ValueError:
        value = None
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise FileExistsError(f"{file} was not written by an export and will not be replaced")


def write_sidecar(path: Path, scene: Scene, *, keeps_order: bool) -> None:
    """Write what a file that is there already does not say of a scene, replacing an older sidecar.

    Args:
        path: The file; its SHA-256 ties the sidecar to it.
        scene: That it holds.
        keeps_order: Whether the Gaussians are in the scene's order, so that each object's are
            those of its gaussian_range.
    """
    entries = [
        {
            "id": item.id,
            "key": item.key,
            "label": item.label,
            **({"gaussian_range": list(item.gaussian_range)} if keeps_order else {}),
        }
        for item in scene.objects
    ]
    value: dict[str, Any] = {
        "format": FORMAT,
        "file": path.name,
        "sha256": sha256_of(path),
        "num_gaussians": len(scene.gaussians.means),
        "about": list(scene_comments(scene, sorted_by_object=keeps_order)),
        "objects": entries,
    }
    write_json(sidecar_path(path), value)


def with_sidecar(path: Path, splats: Splats) -> Splats:
    """The splats of a file with what its sidecar says, if one was written for just this file.

    Raises:
        ValueError: The sidecar is damaged.
    """
    file = sidecar_path(path)
    if not file.is_file():
        return splats
    value = read_json(file, REMEDY)
    with naming_damage(file, REMEDY):
        if not isinstance(value, dict) or value.get("format") != FORMAT:
            return splats
        if value["sha256"] != sha256_of(path):
            note = f"{file} belongs to another version of {path.name} and was not read"
            return replace(splats, notes=(*splats.notes, note))
        about = [text(line) for line in value["about"]]
        splats = replace(splats, up=stated_up(about), units=stated_units(about))
        if len(splats.gaussians.means) != whole_number(value["num_gaussians"]):
            note = f"{path}: Gaussians were dropped, so that the ranges of {file.name} do not hold"
            return replace(splats, notes=(*splats.notes, note))
        ids, labels = torch.zeros_like(splats.object_ids), {}
        for entry in value["objects"]:
            if "gaussian_range" not in entry:
                continue
            start, count = (whole_number(number) for number in entry["gaussian_range"])
            if start + count > len(ids):
                raise ValueError(f"a gaussian_range reaches beyond {len(ids)} Gaussians")
            number = whole_number(entry["id"], 1, 2**31 - 1)
            ids[start : start + count] = number
            if entry["label"] is not None:
                labels[number] = text(entry["label"])
    return replace(splats, object_ids=ids, labels=labels)
