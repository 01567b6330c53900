import torch

from flat_rooms import FlatRooms, oracle
from instok3d.data.batches import make_sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.evaluation.image_quality import psnr
from instok3d.evaluation.simple_baselines import color_masks, nearest_contexts, warped_photos
from instok3d.types import Cameras

ROOMS = FlatRooms([0], ["easy"])


def test_nearest_context_is_by_the_place_of_the_camera():
    sample = make_sample(ROOMS, 0, FrameChoice((2, 8, 14), (3, 10, 12)))
    assert nearest_contexts(sample).tolist() == [0, 1, 2]


def test_warping_by_true_depth_beats_the_photo_as_it_is():
    sample = make_sample(ROOMS, 0, FrameChoice((6, 10), (8,)))
    target = sample.target
    assert target.cam_from_world is not None
    assert target.intrinsics is not None
    geometry = oracle(sample)(sample.context).geometry
    cameras = Cameras(target.cam_from_world[0], target.intrinsics[0])
    warped = warped_photos(sample, geometry, cameras)
    nearest = sample.context.images[0, nearest_contexts(sample)]
    assert psnr(warped, target.images[0]).item() > psnr(nearest, target.images[0]).item() + 3
    # Seen from its own camera a photo warps onto itself: each pixel falls on its own centre.
    own = Cameras(torch.eye(4)[None], target.intrinsics[0])
    same = make_sample(ROOMS, 0, FrameChoice((6, 10), (6,)))
    again = warped_photos(same, geometry, own)
    assert psnr(again, same.target.images[0]).item() > 60


def test_the_nearer_surface_hides_the_farther_one():
    sample = make_sample(ROOMS, 0, FrameChoice((6, 10), (7,)))
    geometry = oracle(sample)(sample.context).geometry
    target = sample.target
    assert target.cam_from_world is not None
    assert target.intrinsics is not None
    cameras = Cameras(target.cam_from_world[0], target.intrinsics[0])
    warped = warped_photos(sample, geometry, cameras)[0]
    # Well inside the boards (their true pixels away from every edge) the boards' colours stay.
    ids = sample.target_instances[0, 0]
    for instance in (2, 3):
        inside = ids == instance
        inside = (
            inside & inside.roll(3, 1) & inside.roll(-3, 1) & inside.roll(3, 0) & inside.roll(-3, 0)
        )
        assert inside.any()
        assert (warped - target.images[0, 0])[:, inside].abs().max() < 0.15


def test_color_masks_find_flat_colours_and_are_deterministic():
    photo = torch.zeros(3, 24, 24)
    photo[0, :, :12] = 1.0
    photo[2, :, 12:] = 1.0
    first, second = color_masks(photo), color_masks(photo)
    assert (first.ids == second.ids).all()
    assert (first.ids >= 0).all()
    assert not set(first.ids[:, :12].ravel()) & set(first.ids[:, 12:].ravel())
    assert abs(float(first.scores.sum()) - 1) < 1e-9
