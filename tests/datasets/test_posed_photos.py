import math
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.datasets.posed_photos import PhotoFiles, prepared_photo
from instok3d.photos.cameras import PhotoCamera
from instok3d.photos.distortion import Distortion
from instok3d.photos.undistortion import undistortion

HEIGHT, WIDTH = 96, 128
INTRINSICS = torch.tensor([[90.0, 0, 66.3], [0, 92.0, 46.8], [0, 0, 1]], dtype=torch.float64)
LENSES = [
    Distortion(),
    Distortion(-0.2),
    Distortion(0.15, 0.02, k3=-0.01),
    Distortion(0.1, -0.1, 0.02, -0.01),
]
TURNED = torch.tensor(
    [[math.cos(0.3), 0, math.sin(0.3), 0.1], [0, 1, 0, 0.2],
     [-math.sin(0.3), 0, math.cos(0.3), 0.3], [0, 0, 0, 1]], dtype=torch.float64
)  # fmt: skip


def camera(distortion=LENSES[0], **changed) -> PhotoCamera:
    values = {
        "name": "a.png", "height": HEIGHT, "width": WIDTH, "intrinsics": INTRINSICS,
        "cam_from_world": TURNED, "distortion": distortion,
    }  # fmt: skip
    return PhotoCamera(**(values | changed))


def position_picture(path: Path, **save) -> Path:
    """Red says the column of a pixel, green its row."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    pixels = np.stack([1.9 * x, 2.5 * y, 0 * x], axis=-1)
    Image.fromarray(pixels.round().astype(np.uint8)).save(path, **save)
    return path


def position_ids(path: Path) -> Path:
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    Image.fromarray((1 + x // 8 + 100 * (y // 8)).astype(np.uint16)).save(path)
    return path


def bend(x: np.ndarray, y: np.ndarray, lens) -> tuple[np.ndarray, np.ndarray]:
    """OpenCV's formula, in its own words."""
    k1, k2, p1, p2, k3 = astuple(lens)
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
    )


@pytest.mark.parametrize("lens", LENSES)
def test_each_pixel_shows_what_its_ray_meets_in_the_photo(tmp_path, lens):
    files = PhotoFiles(
        position_picture(tmp_path / "a.png"), "a", camera(lens), position_ids(tmp_path / "ids.png")
    )
    frame = prepared_photo(files, 48)
    assert frame.intrinsics is not None
    assert frame.instances is not None
    j, i = np.meshgrid(np.arange(48) + 0.5, np.arange(48) + 0.5)
    x = (j - frame.intrinsics[0, 2]) / frame.intrinsics[0, 0]
    y = (i - frame.intrinsics[1, 2]) / frame.intrinsics[1, 1]
    x, y = bend(x, y, lens)
    column, row = 90.0 * x + 66.3, 92.0 * y + 46.8
    inner = (slice(2, -2), slice(2, -2))  # at the border the filter has one side only
    assert np.abs(frame.image[inner][..., 0] - 1.9 * column[inner]).max() < 2
    assert np.abs(frame.image[inner][..., 1] - 2.5 * row[inner]).max() < 2
    off_by = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]  # pixels of the photo, at most
    near = [1 + (column + dx) // 8 + 100 * ((row + dy) // 8) for dx, dy in off_by]
    assert (frame.instances == np.stack(near)).any(axis=0)[inner].all()
    assert frame.world_from_cam == pytest.approx(torch.linalg.inv(TURNED).numpy())
    # The crop is square about the principal point, and loses little to the lens.
    assert frame.intrinsics[0, 2] == pytest.approx(24, abs=0.3)
    assert frame.intrinsics[0, 0] == pytest.approx(90 * 24 / 47, rel=0.08 if lens else 1e-9)


def test_bending_by_hand():
    # The pixel whose ray is (0.5, 0): r2 = 0.25; k1 = 0.1: 0.5 * 1.025 = 0.5125;
    # p1 = 0.01: y += 0.01 * 0.25 = 0.0025; p2 = 0.02: x += 0.02 * (0.25 + 0.5) = 0.015.
    # In a picture of 20 x 20 with f = 10 in its middle: column 10 + 5.275, row 10 + 0.025.
    intrinsics = torch.tensor([[10.0, 0, 10.5], [0, 10, 10.5], [0, 0, 1]], dtype=torch.float64)
    lens = undistortion(intrinsics, Distortion(0.1, 0.0, 0.01, 0.02), 21, 21)
    zoom = float(lens.intrinsics[0, 0]) / 10
    assert 1 < zoom < 1.2
    plain = undistortion(intrinsics, Distortion(-0.1, 0.0, 0.01, 0.02), 21, 21)
    assert float(plain.intrinsics[0, 0]) == 10  # a barrel leaves no gap
    x, y = (21 * plain.positions[10, 15]).tolist()
    assert (x, y) == pytest.approx((10.5 + 10 * (0.5 * 0.975 + 0.015), 10.5 + 0.025))


def test_lenses_beyond_repair_are_refused():
    with pytest.raises(ValueError, match=r"leaves gaps .* undistort the photos first"):
        undistortion(INTRINSICS, Distortion(2.0), HEIGHT, WIDTH)
    with pytest.raises(ValueError, match="leaves gaps"):  # folds back into the picture
        undistortion(INTRINSICS, Distortion(-1.5), HEIGHT, WIDTH)


def test_a_photo_turned_by_exif_shows_the_same_world(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    plain = prepared_photo(PhotoFiles(position_picture(tmp_path / "a.png"), "a", camera()), 64)
    turned_photo = position_picture(tmp_path / "b.png", exif=exif)
    turned = prepared_photo(PhotoFiles(turned_photo, "b", camera()), 64)
    assert turned.intrinsics is not None
    assert turned.world_from_cam is not None
    assert plain.intrinsics is not None
    assert plain.world_from_cam is not None
    assert not np.allclose(turned.world_from_cam, plain.world_from_cam, atol=0.1)
    j, i = np.meshgrid(np.arange(8, 56, 6), np.arange(8, 56, 6))
    pixels = np.stack([j + 0.5, i + 0.5, np.ones(j.shape)], axis=-1).reshape(-1, 3)
    world = pixels @ np.linalg.inv(turned.intrinsics).T @ turned.world_from_cam[:3, :3].T
    in_plain = world @ plain.world_from_cam[:3, :3] @ plain.intrinsics.T
    columns, rows = (in_plain[:, :2] / in_plain[:, 2:]).T
    inside = (columns > 2) & (columns < 62) & (rows > 2) & (rows < 62)
    assert inside.mean() > 0.8
    seen = turned.image[i.ravel(), j.ravel()][inside].astype(float)
    expected = plain.image[rows[inside].astype(int), columns[inside].astype(int)]
    assert np.abs(seen - expected).max() < 6  # one pixel


def test_depth_follows_the_crop_and_unknown_or_far_is_zero(tmp_path):
    depth = np.full((HEIGHT, WIDTH), 1500, dtype=np.uint16)
    depth[:, 100:] = 0
    depth[:20] = 66_000 // 2  # at two numbers a millimetre: 66 m is too far for 16 bits
    Image.fromarray(depth).save(tmp_path / "depth.png")
    photo = position_picture(tmp_path / "a.png")
    known = camera(depth_path=tmp_path / "depth.png", depth_scale=500.0)
    frame = prepared_photo(PhotoFiles(photo, "a", known, with_depth=True), 47)
    assert frame.depth_thousandths is not None
    # The crop of 94 x 94 pixels begins at (66 - 47, 47 - 47) = (19, 0) and is halved.
    assert frame.depth_thousandths[20, 20] == 3000
    assert (frame.depth_thousandths[:9] == 0).all()
    assert (frame.depth_thousandths[:, 41:] == 0).all()
    assert (frame.depth_thousandths[11:, :40] == 3000).all()
    without = prepared_photo(PhotoFiles(photo, "a", camera(), with_depth=True), 47)
    assert (without.depth_thousandths == np.zeros((47, 47))).all()


def test_ids_that_do_not_fit_their_photo_are_refused(tmp_path):
    photo = position_picture(tmp_path / "a.png")
    Image.fromarray(np.ones((48, 64), dtype=np.uint16)).save(tmp_path / "small.png")
    with pytest.raises(ValueError, match=r"small\.png has 64 x 48 pixels, its photo 128 x 96"):
        prepared_photo(PhotoFiles(photo, "a", ids=tmp_path / "small.png"), 32)
    Image.new("RGB", (WIDTH, HEIGHT)).save(tmp_path / "colour.png")
    with pytest.raises(ValueError, match=r"colour\.png has RGB pixels"):
        prepared_photo(PhotoFiles(photo, "a", camera(), tmp_path / "colour.png"), 32)
    exif = Image.Exif()
    exif[0x0112] = 3
    turned = position_picture(tmp_path / "b.png", exif=exif)
    with pytest.raises(ValueError, match=r"b\.png is turned by EXIF"):
        prepared_photo(PhotoFiles(turned, "b", ids=position_ids(tmp_path / "ids.png")), 32)


def test_a_camera_of_another_shape_is_refused(tmp_path):
    photo = position_picture(tmp_path / "a.png")
    with pytest.raises(ValueError, match="for an image of 128 x 128, but the photo has 128 x 96"):
        prepared_photo(PhotoFiles(photo, "a", camera(height=128)), 32)


def test_a_photo_alone_is_cropped_about_its_middle(tmp_path):
    frame = prepared_photo(PhotoFiles(position_picture(tmp_path / "a.png"), "a"), 96)
    assert frame.world_from_cam is None
    assert frame.intrinsics is None
    assert frame.instances is None
    columns = np.arange(16, 112) + 0.5
    assert np.abs(frame.image[40, :, 0] - 1.9 * columns).max() <= 1
