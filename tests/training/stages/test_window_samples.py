"""Samples of many views, learnt window by window on the geometry of all."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import make_sample
from instok3d.data.sample import Sample, collate
from instok3d.data.view_sampling import FrameChoice
from instok3d.geometry.cameras import relative_to_first, transform_points, unproject
from instok3d.training.stages.window_samples import window_samples
from instok3d.types import Cameras, Geometry

FORWARD = FrameChoice((0, 2, 4, 6), (5, 1, 3, 4))
BACKWARD = FrameChoice((7, 5, 3, 1), (2, 4, 6, 0))


@pytest.fixture(scope="module")
def sample() -> Sample:
    rooms = FakeRooms(2, size=16)
    return collate([make_sample(rooms, 0, FORWARD), make_sample(rooms, 1, BACKWARD)])


def true_geometry(sample: Sample) -> Geometry:
    context = sample.context
    pointmaps = torch.stack(
        [
            torch.stack(
                [
                    transform_points(torch.linalg.inv(camera), point.flatten(0, 1)).view_as(point)
                    for camera, point in zip(cameras, points, strict=True)
                ]
            )
            for cameras, points in zip(
                context.cam_from_world, unproject(context.depths, context.intrinsics), strict=True
            )
        ]
    )
    batch, views = context.images.shape[:2]
    return Geometry(
        features=torch.arange(batch * views * 4.0).view(batch, views, 4, 1),
        depths=context.depths,
        pointmaps=pointmaps,
        confidences=torch.ones_like(context.depths),
        cameras=Cameras(context.cam_from_world, context.intrinsics),
    )


def cut(sample: Sample, size: int, seed: int = 0) -> tuple[Sample, Geometry]:
    return window_samples(sample, true_geometry(sample), size, np.random.default_rng(seed))


def test_every_window_is_the_sample_of_its_own_frames(sample):
    """Read from the scene anew: cameras, depths, ids, and the first view as the world."""
    windows, geometry = cut(sample, 2)
    assert len(windows.names) == 4  # two scenes, two windows of two of four views each
    for number, choice in enumerate(windows.frames):
        scene = number // 2
        expected = make_sample(FakeRooms(2, size=16), scene, choice)
        for mine, other in ((windows.context, expected.context), (windows.target, expected.target)):
            assert torch.equal(mine.images[number], other.images[0])
            assert torch.equal(mine.depths[number], other.depths[0])
            assert torch.equal(mine.intrinsics[number], other.intrinsics[0])
            torch.testing.assert_close(
                mine.cam_from_world[number], other.cam_from_world[0], atol=1e-6, rtol=0
            )
        assert torch.equal(windows.context_instances[number], expected.context_instances[0])
        assert torch.equal(windows.target_instances[number], expected.target_instances[0])
        expected_geometry = true_geometry(expected)
        torch.testing.assert_close(
            geometry.pointmaps[number], expected_geometry.pointmaps[0], atol=1e-5, rtol=0
        )
        first = sample.frames[scene].context.index(choice.context[0])
        assert torch.equal(
            geometry.features[number].flatten(),
            torch.arange(8.0) + 16 * scene + 4 * first,
        )
    torch.testing.assert_close(
        geometry.cameras.cam_from_world, relative_to_first(geometry.cameras.cam_from_world)
    )


def test_windows_are_neighbours_and_their_targets_lie_between(sample):
    seen = set()
    for seed in range(30):
        windows, _ = cut(sample, 3, seed)
        assert len(windows.names) == 2  # one of three fits into four
        counts = {len(choice.target) for choice in windows.frames}
        assert len(counts) == 1
        for scene, choice in enumerate(windows.frames):
            whole = sample.frames[scene]
            start = whole.context.index(choice.context[0])
            assert choice.context == whole.context[start : start + 3]
            assert all(min(choice.context) < k < max(choice.context) for k in choice.target)
            assert set(choice.target) <= set(whole.target)
            seen.add((scene, start))
    assert seen == {(0, 0), (0, 1), (1, 0), (1, 1)}


def test_window_without_a_target_is_not_drawn(sample):
    """Frame 1 lies between the first two alone."""
    one = make_sample(FakeRooms(1, size=16), 0, FrameChoice((0, 2, 4, 6), (1, 7)))
    for seed in range(5):
        windows, _ = cut(one, 2, seed)
        assert [choice.context for choice in windows.frames] == [(0, 2)]
        assert [choice.target for choice in windows.frames] == [(1,)]
    none = make_sample(FakeRooms(1, size=16), 0, FrameChoice((0, 2, 4, 6), (7,)))
    with pytest.raises(ValueError, match=r"no target between the frames of 2 .*raise num_targets"):
        cut(none, 2)


def test_sample_of_unknown_frames_is_refused(sample):
    with pytest.raises(ValueError, match="make it with make_sample"):
        cut(replace(sample, frames=()), 2)
