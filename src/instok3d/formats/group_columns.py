"""Which group each row of a foreign PLY belongs to, by the extra columns of other programs."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.reading import naming_damage

COLUMNS = ("object_id", "instance_id", "label_id", "label_ids", "obj_id", "ins_id", "group_id",
           "segment_id", "cluster_id", "label")  # fmt: skip
"""Columns of whole numbers that are taken for groups, the first that is there; 0 and numbers below
it are no group. object_id is ours."""
FEATURES = "obj_dc_"
"""Gaussian Grouping's identity features; its classifier turns them into numbers of objects."""
CLASSIFIER = "classifier.pth"
CLASSIFIER_LIMIT_BYTES = 2**24
LARGEST = 2**31 - 1
ROWS_AT_ONCE = 65_536


def group_ids(path: Path, rows: np.ndarray) -> tuple[Int[Tensor, " gaussian"] | None, tuple]:
    """The group of each row, None where the file has none; and notes of what could not be told.

    Args:
        path: The PLY; Gaussian Grouping's classifier is looked for beside it.
        rows: Its table of Gaussians.

    Raises:
        ValueError: The column holds other things than whole numbers, or the classifier does not
            fit the features.
    """
    names = rows.dtype.names or ()
    found = next((name for name in COLUMNS if name in names), None)
    if found is not None:
        return _of_column(path, found, rows[found]), ()
    features = [name for name in names if name.startswith(FEATURES)]
    if not features:
        return None, ()
    classifier = path.parent / CLASSIFIER
    if not classifier.is_file():
        return None, (
            f"{path} has identity features ({FEATURES}*) but no {CLASSIFIER} lies beside it, "
            "without which they tell no groups",
        )
    return _classified(classifier, rows, sorted(features, key=lambda n: (len(n), n))), ()


def _of_column(path: Path, name: str, values: np.ndarray) -> Int[Tensor, " gaussian"]:
    with np.errstate(invalid="ignore", over="ignore"):
        numbers = np.asarray(values, np.float64)
        sound = (np.abs(numbers) <= LARGEST) & (numbers == np.rint(numbers))
    if not sound.all():
        raise ValueError(
            f"{path}: the column {name} holds {int((~sound).sum())} values that are no whole "
            "numbers of groups; remove or rename it to read the Gaussians without groups"
        )
    return torch.from_numpy(numbers.astype(np.int64)).clamp_min(0)


def _classified(
    classifier: Path, rows: np.ndarray, features: list[str]
) -> Int[Tensor, " gaussian"]:
    """The class of the largest score; a 1 x 1 convolution is a matrix."""
    remedy = "give the classifier.pth that was trained with this PLY, or remove it"
    with naming_damage(classifier, remedy):
        if classifier.stat().st_size > CLASSIFIER_LIMIT_BYTES:
            raise ValueError("it is larger than a classifier can be")
        state = torch.load(classifier, map_location="cpu", weights_only=True)
        weight, bias = state["weight"].float(), state["bias"].float()
        if weight.ndim != 4 or weight.shape[1:] != (len(features), 1, 1):
            raise ValueError(
                f"its weight is {tuple(weight.shape)}, wanted (classes, {len(features)}, 1, 1)"
            )
        if bias.shape != weight.shape[:1]:
            raise ValueError(f"its bias is {tuple(bias.shape)}, wanted {tuple(weight.shape[:1])}")
    ids = torch.zeros(len(rows), dtype=torch.long)
    for start in range(0, len(rows), ROWS_AT_ONCE):
        part = rows[start : start + ROWS_AT_ONCE]
        table = np.stack([np.asarray(part[name], np.float32) for name in features], axis=1)
        scores = torch.from_numpy(table) @ weight[:, :, 0, 0].mT + bias
        ids[start : start + len(part)] = scores.argmax(dim=1)
    return ids
