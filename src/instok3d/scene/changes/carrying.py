"""Traits of one capture in the world of another."""

from dataclasses import replace

import torch

from instok3d.geometry.moving import Similarity
from instok3d.scene.changes.traits import Traits


def carried_by(traits: Traits, move: Similarity) -> Traits:
    """The traits in the world that a similarity leads to."""
    return replace(
        traits, centers=move.points(traits.centers), points=move.points(traits.points),
        extents=traits.extents * move.scale, spacing=traits.spacing * move.scale,
        marks=traits.marks.carried(move),
    )  # fmt: skip


def inverse(move: Similarity) -> Similarity:
    """The similarity that leads back."""
    w, i, j, k = move.quat_wxyz
    turned = Similarity(quat_wxyz=(w, -i, -j, -k), scale=1 / move.scale)
    x, y, z = turned.points(-torch.tensor([move.translation], dtype=torch.float64))[0].tolist()
    return replace(turned, translation=(x, y, z))
