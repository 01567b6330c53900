from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from fake_rooms import FakeRooms
from instok3d.data.batches import make_sample
from instok3d.data.joined import JoinedScenes
from instok3d.data.mirror import mirror_sample
from instok3d.data.sample import collate, photos_only
from instok3d.data.view_sampling import FrameChoice
from instok3d.data.words import ObjectWords
from instok3d.geometry.cameras import invert_rigid, project, transform_points, unproject


@pytest.fixture(scope="module")
def sample():
    return make_sample(FakeRooms(1, size=24), 0, FrameChoice((4, 2), (3, 4)))


def test_first_context_camera_is_the_world(sample):
    torch.testing.assert_close(sample.context.cam_from_world[0, 0], torch.eye(4))
    # Frames 4 and 2 of the line of cameras are 2 x 0.06 m apart.
    centers = invert_rigid(sample.context.cam_from_world)[0, :, :3, 3]
    torch.testing.assert_close((centers[0] - centers[1]).norm(), torch.tensor(0.12))


def test_target_that_is_a_context_frame_equals_it(sample):
    assert torch.equal(sample.target.images[:, 1], sample.context.images[:, 0])
    assert torch.equal(sample.target.cam_from_world[:, 1], sample.context.cam_from_world[:, 0])


def test_depth_and_cameras_carry_one_view_onto_the_other(sample):
    """Points of view 0 land in view 1 at its depth, except where something hides them."""
    context = sample.context
    points = unproject(context.depths[0, :1], context.intrinsics[0, :1]).reshape(1, -1, 3)
    seen = transform_points(context.cam_from_world[0, 1:2], points)
    pixels = project(seen, context.intrinsics[0, 1:2])[0]
    inside = ((pixels > 0) & (pixels < 24)).all(-1)
    grid = (pixels[inside] / 24 * 2 - 1)[None, None]
    depths = functional.grid_sample(context.depths[:, 1:2], grid, align_corners=False)
    error = (depths.flatten() - seen[0, inside, 2]).abs()
    assert inside.float().mean() > 0.8
    assert error.median() < 0.01  # bilinear depth at 24 pixels of a 5 m room


def test_photos_only_hides_what_is_known(sample):
    bare = photos_only(sample.context)
    assert bare.images is sample.context.images
    assert bare.intrinsics is None
    assert bare.cam_from_world is None
    assert bare.depths is None
    assert photos_only(sample.context, keep_intrinsics=True).intrinsics is not None


def test_collate_keeps_order_and_names(sample):
    other = make_sample(FakeRooms(2, size=24), 1, FrameChoice((0, 2), (1, 0)))
    both = collate([sample, other])
    assert both.context.images.shape == (2, 2, 3, 24, 24)
    assert both.target.depths is not None
    assert other.target.depths is not None
    assert torch.equal(both.target.depths[1], other.target.depths[0])
    assert both.names == ("0 frames 4,2", "1 frames 0,2")


def test_collate_refuses_nothing_and_unlike_samples(sample):
    other = make_sample(FakeRooms(1, size=24), 0, FrameChoice((0, 2, 4), (1, 0)))
    with pytest.raises(ValueError, match="at least one"):
        collate([])
    with pytest.raises(ValueError, match="agree in views"):
        collate([sample, other])


def test_collate_refuses_what_only_some_samples_know(sample):
    bare = replace(sample, context=photos_only(sample.context))
    with pytest.raises(ValueError, match="intrinsics must be known in all samples"):
        collate([sample, bare])
    assert collate([bare, bare]).context.depths is None


def test_words_travel_with_their_scene(sample):
    words = {1: ObjectWords("box", "red", "cardboard")}
    named = replace(sample, words=(words,))
    assert sample.words == ({},)
    assert collate([sample, named]).words == ({}, words)
    assert mirror_sample(named).words == named.to("cpu").words == (words,)
    assert JoinedScenes([FakeRooms(1)]).frames(0, [0]).words == {}
