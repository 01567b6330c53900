"""Rooms of boxes with cameras and marks, as a model would give them."""

from collections.abc import Mapping
from dataclasses import replace

import torch

from box_room import OFFICE, Point, Thing, box_room, with_cameras
from instok3d.geometry.moving import Similarity
from instok3d.scene.record import SceneTokens
from instok3d.scene.scene import Scene

EYES = [(2.0, -1.5, 1.8), (3.5, 0.2, 1.6), (1.5, -0.5, 2.2)]
TARGET = (1.6, 1.8, 0.4)
EVERY, CHANNELS = 50, 16
"""One mark for so many Gaussians."""


def marked(scene: Scene, *, seed: int = 0) -> Scene:
    """The scene with marks whose looks depend on the object's name and the Gaussian's number alone.

    Args:
        scene: Objects of at least EVERY Gaussians, each of which has as many in every capture.
        seed: Another one gives looks that no other room has.
    """
    rows, groups, looks = [], [], []
    for item in scene.objects:
        generator = torch.Generator().manual_seed(sum((item.label or "").encode()) + 1000 * seed)
        start, count = item.gaussian_range
        own = torch.arange(start, start + count, EVERY)
        rows.append(own)
        groups += [item.id - 1] * len(own)
        looks.append(torch.randn(len(own), CHANNELS, generator=generator))
    index = torch.cat(rows)
    assignment = torch.zeros(len(index), scene.tokens.assignment.shape[1])
    assignment[torch.arange(len(index)), torch.tensor(groups)] = 1
    tokens = SceneTokens(
        scene.gaussians.means[index],
        torch.cat(looks),
        torch.zeros(len(scene.tokens.groups), CHANNELS),
        assignment,
    )
    return replace(scene, tokens=tokens)


def capture(
    scene: Scene, eyes: list[Point] = EYES, target: Point = TARGET, *, seed: int = 0
) -> Scene:
    """The scene with cameras and marks."""
    return marked(with_cameras(scene, eyes, target), seed=seed)


def office(things: Mapping[str, Thing] = OFFICE, motion: Similarity | None = None) -> Scene:
    """The office of enough Gaussians to hide what is behind them."""
    return box_room(things, each=1200, motion=motion)
