"""Every set of real photos beside the project loads, and what it says about itself agrees."""

import warnings
from pathlib import Path

import pytest
import torch

from instok3d.geometry.cameras import invert_rigid, project, transform_points, unproject
from instok3d.photos.camera_files import read_cameras
from instok3d.photos.loading import load_photos, read_photos
from instok3d.types import Views

UNPOSED = ["iggt_demo9", "lsm_scene1", "lsm_scene2", "vrnerf_kitchen", "vrnerf_riverview",
           "vrnerf_workshop"]  # fmt: skip
RGBD = {"open3d_livingroom": 0.02, "sevenscenes_redkitchen": 0.04, "threedmatch_studyroom": 0.10}


@pytest.mark.parametrize("name", UNPOSED)
def test_unposed_photos_load(shared: Path, name):
    folder = shared / "data" / "unposed_photos" / name
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        photos = read_photos(folder, height=128, width=128)
    assert photos.views.images.shape[1] == len(list(folder.iterdir()))
    assert photos.views.images.std() > 0.1
    assert photos.warnings == ()


def depth_error(views: Views, source: int, target: int) -> tuple[float, float]:
    """Median depth disagreement of a warp, and the share of pixels that could be compared."""
    assert views.depths is not None
    assert views.intrinsics is not None
    assert views.cam_from_world is not None
    depths, cam_from_world = views.depths[0], views.cam_from_world[0]
    points = unproject(depths[source], views.intrinsics[0, source])[depths[source] > 0]
    target_from_source = cam_from_world[target] @ invert_rigid(cam_from_world[source])
    points = transform_points(target_from_source, points)
    points = points[points[:, 2] > 0.1]
    column, row = project(points, views.intrinsics[0, target]).floor().long().unbind(-1)
    height, width = depths.shape[1:]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    seen = depths[target][row[inside], column[inside]]
    z = points[inside, 2]
    return float((seen - z)[seen > 0].abs().median()), float(
        (seen > 0).sum() / depths[source].numel()
    )


@pytest.mark.parametrize("fit", ["crop", "letterbox"])
@pytest.mark.parametrize("name", list(RGBD))
def test_depth_and_cameras_of_neighbouring_frames_agree(shared: Path, name, fit):
    folder = shared / "data" / "rgbd_posed" / name
    paths = sorted((folder / "color").iterdir())[:5]
    photos = load_photos(paths, height=128, width=128, fit=fit, cameras=read_cameras(folder))
    assert photos.units == "metres"
    error_m, share = depth_error(photos.views, 0, 1)
    assert error_m < RGBD[name]
    assert share > 0.2
    # The check can fail: with the cameras exchanged the surfaces lie apart.
    matrices = photos.views.cam_from_world
    assert matrices is not None
    moved = matrices.clone()
    moved[:, 1, 2, 3] += 0.3
    views = photos.views
    wrong = Views(views.images, views.intrinsics, moved, views.depths)
    assert depth_error(wrong, 0, 1)[0] > 2 * RGBD[name]


def test_a_long_posed_walk_is_thinned_out_to_cover_it(shared: Path):
    folder = shared / "data" / "rgbd_posed" / "sevenscenes_redkitchen"
    with pytest.warns(UserWarning, match="56 of 64 photos were left out"):
        photos = read_photos(folder / "color", height=64, width=64, max_views=8, cameras=folder)
    assert photos.names[0] == "000000.jpg"
    assert photos.views.cam_from_world is not None
    centers = invert_rigid(photos.views.cam_from_world[0].double())[:, :3, 3]
    every = torch.stack(
        [invert_rigid(c.cam_from_world)[:3, 3] for c in read_cameras(folder).cameras]
    )
    assert torch.cdist(every, centers).min(dim=1).values.max() < 0.5
