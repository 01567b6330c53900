"""What the files of a feature cache must hold; each is checked when it is read."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from instok3d.geometry.checks import check_intrinsics, check_rigid
from instok3d.reading import naming_damage, one_of, read_json, text, whole_number

FORMAT = "instok3d-features-1"
INDEX = "features.json"
REMEDY = "make the features anew with `instok3d train cache` into another folder"
"""What to do about a damaged index."""
REPLACE = "run `instok3d train cache` again to replace it"
"""What to do about another damaged file: that command finds it and writes it again."""
ANSWER = ("features", "depths", "confidences", "cam_from_world", "intrinsics")
"""Tensors of each sample; a backbone with pointmaps of its own has these too."""
SETTINGS = {
    "backbone": dict, "backbone_sha256": str, "patch_size": int, "feature_channels": int,
    "inputs": list, "dtype": str, "amp": bool, "seed": int, "batches": dict,
    "validation_views": list,
}  # fmt: skip
"""By kind."""


def read_index(folder: Path) -> dict[str, Any]:
    """The index of a cache: format, settings, names of training and held-out scenes.

    Raises:
        FileNotFoundError: There is no cache.
        ValueError: It is of another version, or damaged.
    """
    path = folder / INDEX
    if not path.is_file():
        raise FileNotFoundError(
            f"{folder} holds no cached features (no {INDEX}); make them with `instok3d train cache`"
        )
    index = read_json(path, REMEDY)
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        raise ValueError(f"{path} is no index of cached features of this version ({FORMAT})")
    with naming_damage(path, REMEDY):
        _check_settings(index["settings"])
        for role in ("training", "held_out"):
            if not isinstance(index[role], list):
                raise ValueError(f"{role} is no list of names")
            for name in index[role]:
                text(name)
    return index


def check_answer(
    found: Mapping[str, Tensor], settings: Mapping[str, Any], views: int, where: str
) -> None:
    """Refuse features of a sample that no backbone of these settings can have given.

    Args:
        found: Its tensors.
        settings: Of the cache.
        views: Of the sample.
        where: The file and the sample, the subject of the message.

    Raises:
        ValueError: A tensor is missing, of another shape, or not finite, a depth or a confidence
            is negative, or a camera cannot be.
    """
    lacking = [name for name in ANSWER if name not in found]
    if lacking:
        raise ValueError(f"{where} lacks {', '.join(lacking)}; {REPLACE}")
    height, width = found["depths"].shape[-2:] if found["depths"].ndim >= 2 else (0, 0)
    patches = (height // settings["patch_size"]) * (width // settings["patch_size"])
    shapes = {
        "features": (views, patches, settings["feature_channels"]),
        "depths": (views, height, width),
        "confidences": (views, height, width),
        "cam_from_world": (views, 4, 4),
        "intrinsics": (views, 3, 3),
        "pointmaps": (views, height, width, 3),
    }
    for name, value in found.items():
        shape = tuple(value.shape)
        if name not in shapes or shape != shapes[name]:
            raise ValueError(
                f"{where} has {name} of the shape {shape}, wanted {shapes.get(name)}; {REPLACE}"
            )
        if not value.is_floating_point() or not value.isfinite().all():
            raise ValueError(f"{where} has values in {name} that are not finite; {REPLACE}")
        if name in ("depths", "confidences") and (value < 0).any():
            raise ValueError(f"{where} has {name} below 0; {REPLACE}")
    for view in range(views):
        camera = f"{where} view {view}"
        check_rigid(found["cam_from_world"][view].float(), where=camera)
        intrinsics = found["intrinsics"][view].float()
        check_intrinsics(intrinsics, where=camera, width=width, height=height, margin=float("inf"))


def _check_settings(settings: dict[str, Any]) -> None:
    for name, kind in SETTINGS.items():
        if type(settings[name]) is not kind:
            raise ValueError(f"{name} in its settings is {settings[name]!r}")
    for name in ("patch_size", "feature_channels"):
        whole_number(settings[name], 1, 2**20)
    if not re.fullmatch("[0-9a-f]{64}", settings["backbone_sha256"]):
        raise ValueError("backbone_sha256 in its settings is no SHA-256")
    for name in settings["inputs"]:
        one_of(name, ("photos", "intrinsics"))
    for count in (*settings["validation_views"], *settings["batches"]["views"]):
        whole_number(count, 1)
    whole_number(settings["batches"]["samples_per_scene"], 1)
