import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from depth_room import HEIGHT, INTRINSICS, WIDTH, room
from instok3d.photos.cameras import CameraSet, PhotoCamera
from instok3d.photos.depth_checks import DepthViews, check_depth, read_depth_views
from instok3d.photos.loading import load_photos


def views(count: int, factor: float = 1.0, step: float = 0.15) -> DepthViews:
    depths, cam_from_world = room(count, step)
    names = tuple(f"{index}.jpg" for index in range(count))
    return DepthViews(factor * depths, INTRINSICS.expand(count, 3, 3), cam_from_world, names)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 20])
@pytest.mark.parametrize("metric", [True, False])
def test_depth_that_fits_its_cameras_passes_without_a_word(count, metric):
    assert check_depth(views(count, step=0.05), metric=metric) == []


def test_it_is_the_ratio_that_counts_where_the_unit_is_arbitrary():
    fitting = views(4)
    for unit in (1e-6, 1e6):
        cam_from_world = fitting.cam_from_world.clone()
        cam_from_world[:, :3, 3] *= unit
        scaled = DepthViews(
            unit * fitting.depths, fitting.intrinsics, cam_from_world, fitting.names
        )
        assert check_depth(scaled, metric=False) == []


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 0.01, 0.1, 0.2, 0.5, 2.0, 5.0, 10.0, 1e3, 1e6])
def test_depth_in_another_unit_than_the_cameras_is_refused(factor):
    with pytest.raises(ValueError, match=r"does not fit the cameras: .* times as large"):
        check_depth(views(4, factor), metric=False)


def test_the_factor_that_is_missing_is_told():
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        check_depth(views(4, 0.2), metric=False)
    factor = float(str(caught.value).partition("depths about ")[2].partition(" times")[0])
    assert factor == pytest.approx(5, rel=0.2)


@pytest.mark.parametrize("count", [1, 2, 4])
@pytest.mark.parametrize("factor", [1e-3, 0.01, 100.0, 1e3])
def test_rooms_of_centimetres_or_kilometres_are_never_metres(count, factor):
    with pytest.raises(ValueError, match=r"0\.jpg .* m in the median, which is no room"):
        check_depth(views(count, factor), metric=True)


def test_cameras_at_one_place_say_nothing_about_the_scale():
    turning = views(3, 1e-3, step=0.0)
    assert check_depth(turning, metric=False) == []


def test_depth_that_is_nowhere_is_refused():
    nothing = views(3, 0.0)
    with pytest.raises(ValueError, match=r"of 0\.jpg, 1\.jpg, 2\.jpg hold no depth"):
        check_depth(nothing, metric=False)


@pytest.mark.parametrize("metric", [True, False])
def test_depth_that_is_the_same_everywhere_is_refused(metric):
    flat = views(3)
    flat.depths[:] = 65.534
    flat.depths[1, :9] = 0
    with pytest.raises(ValueError, match=r"is 65\.534 in every pixel"):
        check_depth(flat, metric=metric)


def test_single_views_without_use_are_told():
    some = views(4)
    some.depths[1] = 0
    some.depths[2] = 65.534
    empty, flat = check_depth(some, metric=True)
    assert "1.jpg hold no depth" in empty
    assert "2.jpg is the same in every pixel" in flat


def test_depth_that_contradicts_the_cameras_is_told(rng):
    noise = views(3)
    noise.depths[:] = 0.5 + 9 * torch.rand(noise.depths.shape, generator=rng)
    (note,) = check_depth(noise, metric=True)
    assert "contradict each other" in note


def test_a_scale_that_cannot_be_checked_is_told():
    # Steps of a hundredth of a millimetre: no pixel moves, at this scale or another.
    (note,) = check_depth(views(3, step=1e-5), metric=False)
    assert "its scale could not be checked" in note


STORED = {
    "metres read as millimetres": (lambda d: d.astype(np.float32), r"m in the median|does not fit"),
    "byte-swapped": (lambda d: (1000 * d).astype(np.uint16).byteswap(), r"looks byte-swapped"),
    "constant": (lambda d: np.full(d.shape, 65534, np.uint16), r"65\.534 in every pixel"),
    "all zero": (lambda d: np.zeros(d.shape, np.uint16), r"hold no depth"),
    "all missing": (lambda d: np.full(d.shape, 65535, np.uint16), r"hold no depth"),
    "all NaN": (lambda d: np.full(d.shape, np.nan, np.float32), r"hold no depth"),
    "endless": (lambda d: np.full(d.shape, 1e30, np.float32), r"hold no depth"),
}


def capture(folder: Path, store, count: int) -> CameraSet:
    depths, cam_from_world = room(count)
    cameras = []
    for index in range(count):
        Image.new("RGB", (WIDTH, HEIGHT), (9 * index,) * 3).save(folder / f"{index}.png")
        np.save(folder / f"{index}.npy", store(depths[index].numpy()))
        cameras.append(
            PhotoCamera(
                f"{index}.png", HEIGHT, WIDTH, INTRINSICS, cam_from_world[index],
                depth_path=folder / f"{index}.npy",
            )
        )  # fmt: skip
    return CameraSet(tuple(cameras), folder, "metres")


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("kind", STORED)
def test_depth_files_that_are_no_depth_in_metres_are_refused(tmp_path, kind, count):
    store, message = STORED[kind]
    cameras = capture(tmp_path, store, count)
    paths = [tmp_path / f"{index}.png" for index in range(count)]
    with pytest.raises(ValueError, match=message):
        load_photos(paths, height=36, width=36, cameras=cameras)


def test_depth_files_in_millimetres_pass(tmp_path):
    cameras = capture(tmp_path, lambda d: (1000 * d).astype(np.uint16), 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        photos = load_photos(
            [tmp_path / f"{index}.png" for index in range(3)], height=36, width=36, cameras=cameras
        )
    assert photos.views.depths is not None
    assert 1 < float(photos.views.depths.median()) < 5


def test_a_few_depth_pictures_stand_for_many(tmp_path):
    cameras = capture(tmp_path, lambda d: (1000 * d).astype(np.uint16), 11)
    chosen = read_depth_views(cameras.cameras)
    assert chosen.names == tuple(f"{k}.png" for k in (0, 2, 4, 6, 8, 10))
    assert check_depth(chosen, metric=True) == []
    assert check_depth(read_depth_views([]), metric=True) == []
