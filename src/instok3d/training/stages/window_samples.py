"""Samples of many views as the windows in which the model takes them."""

from dataclasses import replace

import numpy as np
import torch

from instok3d.data.sample import Sample, collate
from instok3d.data.view_sampling import FrameChoice
from instok3d.geometry.cameras import invert_rigid
from instok3d.model.views.windows import cut_window
from instok3d.types import Geometry, Views


def window_samples(
    sample: Sample, geometry: Geometry, size: int, rng: np.random.Generator
) -> tuple[Sample, Geometry]:
    """Windows of neighbouring context views as samples of their own, in a batch.

    The model then learns a window at the price of one, on what the backbone said of all views.
    Every sample gives as many windows as fit into its views side by side, at places drawn anew
    that may overlap. Targets are those that lie between the frames of a window, as many for each
    window as the one with the fewest has, drawn too.

    Args:
        sample: Its contexts are in the order of the path, in either direction.
        geometry: Of its context views.
        size: Views of a window, at least 2 and fewer than the sample has.
        rng: Draws windows and targets.

    Raises:
        ValueError: The sample does not say which frames it holds, or a scene has no target
            between the frames of any window.
    """
    num_views = sample.context.images.shape[1]
    if len(sample.frames) != len(sample.context.images):
        raise ValueError(
            f"a sample of {num_views} views is learnt in windows of {size}, which needs the frames "
            "it was made of, and these are not known; make it with make_sample"
        )
    drawn: list[tuple[int, range, list[int]]] = []
    for scene, frames in enumerate(sample.frames):
        usable = [
            (window, targets)
            for start in range(num_views - size + 1)
            if (targets := _between(frames, window := range(start, start + size)))
        ]
        if not usable:
            raise ValueError(
                f"{sample.names[scene]} has no target between the frames of {size} neighbouring "
                f"views, targets are {frames.target}; raise num_targets"
            )
        count = min(num_views // size, len(usable))
        chosen = sorted(rng.choice(len(usable), size=count, replace=False))
        drawn += [(scene, *usable[number]) for number in chosen]
    fewest = min(len(targets) for _, _, targets in drawn)
    parts = [
        _cut(sample, scene, window, sorted(rng.permutation(targets)[:fewest].tolist()))
        for scene, window, targets in drawn
    ]
    seen = [cut_window(sample.context, geometry, scene, window)[1] for scene, window, _ in drawn]
    return collate(parts), Geometry.concatenate(seen)


def _between(frames: FrameChoice, window: range) -> list[int]:
    """Numbers of the targets that lie between the first and the last frame of a window."""
    shown = [frames.context[view] for view in window]
    return [k for k, frame in enumerate(frames.target) if min(shown) < frame < max(shown)]


def _cut(sample: Sample, scene: int, window: range, targets: list[int]) -> Sample:
    """One window of a scene as a batch of one, its first camera as the world."""
    cam_from_world = sample.context.cam_from_world
    assert cam_from_world is not None
    world_from_first = invert_rigid(cam_from_world[scene, window[0]].double())

    def views(all_views: Views, kept: torch.Tensor) -> Views:
        def cut(values: torch.Tensor | None) -> torch.Tensor | None:
            return None if values is None else values[scene, kept][None]

        cameras = all_views.cam_from_world
        assert cameras is not None
        moved = (cameras[scene, kept].double() @ world_from_first).to(cameras)[None]
        return Views(
            all_views.images[scene, kept][None],
            cut(all_views.intrinsics),
            moved,
            cut(all_views.depths),
        )

    context, target = torch.as_tensor(window), torch.as_tensor(targets)
    frames = sample.frames[scene]
    return replace(
        sample,
        context=views(sample.context, context),
        target=views(sample.target, target),
        context_instances=sample.context_instances[scene, context][None],
        target_instances=sample.target_instances[scene, target][None],
        names=(f"{sample.names[scene]} views {window[0]} to {window[-1]}",),
        keys=(),
        frames=(
            FrameChoice(
                tuple(frames.context[view] for view in window),
                tuple(frames.target[number] for number in targets),
            ),
        ),
    )
