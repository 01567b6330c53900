import pytest
import torch

from instok3d.model.views.view_path import order_along_path, view_overlaps
from instok3d.types import Cameras, Geometry


def facing_a_wall(cam_from_world: torch.Tensor) -> Geometry:
    """Cameras one unit before a wall; 32 pixels across with a field of view of 90 degrees."""
    views = len(cam_from_world)
    x = (torch.arange(32) + 0.5 - 16) / 16
    here = torch.stack([x.expand(32, 32), x[:, None].expand(32, 32), torch.ones(32, 32)], dim=-1)
    world_from_cam = torch.linalg.inv(cam_from_world)
    points = here @ world_from_cam[:, None, :3, :3].mT + world_from_cam[:, None, None, :3, 3]
    intrinsics = torch.tensor([[16.0, 0, 16], [0, 16, 16], [0, 0, 1]]).expand(views, 3, 3)
    return Geometry(
        features=torch.zeros(1, views, 16, 1),
        depths=torch.ones(1, views, 32, 32),
        pointmaps=points[None],
        confidences=torch.ones(1, views, 32, 32),
        cameras=Cameras(cam_from_world[None], intrinsics[None]),
    )


def test_overlap_by_hand():
    # Points lie every 8 pixels, from -0.72 to 0.78. Camera 1 stands half a picture (1 unit)
    # to the right: of 4 columns 2 fall into it. Camera 2 looks the other way.
    cameras = torch.eye(4).repeat(3, 1, 1)
    cameras[1, 0, 3] = -1.0
    cameras[2, 0, 0] = cameras[2, 2, 2] = -1.0
    overlaps = view_overlaps(facing_a_wall(cameras), 0)
    expected = torch.tensor([[0, 0.5, 0], [0.5, 0, 0], [0, 0, 0]])
    torch.testing.assert_close(overlaps, expected)


def test_a_point_behind_what_the_other_sees_or_unknown_is_not_seen():
    geometry = facing_a_wall(torch.eye(4).repeat(2, 1, 1))
    geometry.depths[0, 1, :16] = 0.5  # something stands before the upper half of view 1
    geometry.pointmaps[0, 0, :, :16] = torch.nan
    # View 1 sees a quarter of view 0's points (known and not hidden), view 0 all of view 1's.
    assert view_overlaps(geometry, 0)[0, 1].item() == pytest.approx((0.25 + 1) / 2)


def test_views_of_a_walk_come_out_in_its_order_however_they_were_numbered(rng):
    place = torch.arange(9.0)
    walk = torch.exp(-((place[:, None] - place) ** 2) / 2).fill_diagonal_(0)
    for _ in range(5):
        shuffled = torch.randperm(9, generator=rng)
        path = order_along_path(walk[shuffled][:, shuffled])
        along = shuffled[path].tolist()
        assert along in (list(range(9)), list(range(8, -1, -1)))
        assert path[0] < path[-1]


def test_one_two_and_unrelated_views_have_an_order_too():
    assert order_along_path(torch.zeros(1, 1)) == [0]
    assert order_along_path(torch.zeros(2, 2)) in ([0, 1], [1, 0])
    assert sorted(order_along_path(torch.zeros(5, 5))) == list(range(5))
