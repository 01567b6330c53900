import hashlib
import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.photos.cameras import CameraSet, PhotoCamera
from instok3d.photos.loading import PhotoSet, find_images, load_photos, read_photos


def save(path: Path, height: int = 60, width: int = 80, seed: int = 0, **options) -> Path:
    """A smooth random picture; its seed makes it unlike the others."""
    small = np.random.default_rng(seed).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    image = Image.fromarray(small).resize((width, height), Image.Resampling.BICUBIC)
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, **options)
    return path


def focal_exif(focal_35mm: int) -> Image.Exif:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = focal_35mm
    return exif


def camera(name: str, **more) -> PhotoCamera:
    intrinsics = torch.tensor([[80.0, 0, 40], [0, 80, 30], [0, 0, 1]]).double()
    return PhotoCamera(name, 60, 80, intrinsics, torch.eye(4).double(), **more)


def quietly(*args, **kwargs) -> PhotoSet:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_photos(*args, **kwargs)


def test_mixed_photos_become_one_batch(tmp_path):
    paths = [
        save(tmp_path / "a" / "1.jpg", 60, 80),
        save(tmp_path / "b" / "1.png", 90, 60),
        save(tmp_path / "b" / "2.webp", 200, 200),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        photos = load_photos(paths, height=32, width=32)
    assert photos.views.images.shape == (1, 3, 3, 32, 32)
    assert photos.views.images.min() >= 0
    assert photos.views.images.max() <= 1
    assert photos.views.intrinsics is None
    assert photos.views.cam_from_world is None
    assert photos.views.depths is None
    assert photos.names == ("a/1.jpg", "b/1.png", "b/2.webp")
    assert photos.paths == tuple(paths)
    assert photos.sha256[0] == hashlib.sha256(paths[0].read_bytes()).hexdigest()
    assert [m.original_height for m in photos.pixel_maps] == [60, 90, 200]
    assert photos.units == "arbitrary"
    assert photos.intrinsics_source is None
    assert photos.warnings == ()


def test_the_same_files_give_the_same_bits(tmp_path):
    paths = [save(tmp_path / f"{i}.jpg", 300, 400, seed=i) for i in range(5)]
    first = load_photos(paths, height=32, width=32)
    again = load_photos(paths, height=32, width=32)
    assert torch.equal(first.views.images, again.views.images)
    alone = quietly([paths[3]], height=32, width=32)
    assert torch.equal(first.views.images[:, 3], alone.views.images[:, 0])


def test_focal_lengths_of_exif_become_intrinsics(tmp_path):
    # 300 x 400 with a diagonal of 500: f = 26 x 500 / 43.2666 = 300.463; a fifth of it at 60 x 60
    # (scale 1/5), where the principal point stays in the middle.
    paths = [save(tmp_path / f"{i}.jpg", 300, 400, exif=focal_exif(26)) for i in range(2)]
    photos = load_photos(paths, height=60, width=60)
    expected = torch.tensor([[60.0926, 0, 30], [0, 60.0926, 30], [0, 0, 1]]).expand(1, 2, 3, 3)
    assert photos.views.intrinsics is not None
    torch.testing.assert_close(photos.views.intrinsics, expected, atol=1e-3, rtol=0)
    assert photos.intrinsics_source == "exif"


def test_focal_lengths_of_only_some_photos_are_not_used_and_told(tmp_path):
    paths = [save(tmp_path / "0.jpg", exif=focal_exif(26)), save(tmp_path / "1.jpg")]
    with pytest.warns(UserWarning, match="only 1 of 2 photos state their focal length"):
        photos = load_photos(paths, height=16, width=16)
    assert photos.views.intrinsics is None


def test_one_photo_works_with_a_warning(tmp_path):
    with pytest.warns(UserWarning, match="only one photo: its depth is a guess"):
        photos = load_photos([save(tmp_path / "a.jpg")], height=16, width=16)
    assert photos.views.images.shape == (1, 1, 3, 16, 16)
    assert len(photos.warnings) == 1


def test_a_photo_of_one_pixel_works_with_a_warning(tmp_path):
    save(tmp_path / "a.png", 1, 1)
    photos = quietly([tmp_path / "a.png"], height=16, width=16)
    assert photos.views.images.isfinite().all()
    assert any("fewer pixels than the model" in note for note in photos.warnings)


def test_a_wide_photo_that_loses_much_is_told(tmp_path):
    paths = [save(tmp_path / "a.jpg", 60, 120), save(tmp_path / "b.jpg")]
    with pytest.warns(UserWarning, match=r"1 of 2 photos lose up to 50% "):
        load_photos(paths, height=16, width=16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_photos(paths, height=16, width=16, fit="letterbox")


def test_of_too_many_photos_those_that_differ_are_kept(tmp_path):
    # Ten copies of one view, and two others: three views must be the three different ones.
    seeds = [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]
    paths = [save(tmp_path / f"{i}.png", seed=seed) for i, seed in enumerate(seeds)]
    with pytest.warns(UserWarning, match="9 of 12 photos were left out: max_views is 3"):
        photos = load_photos(paths, height=16, width=16, max_views=3)
    assert photos.names == ("0.png", "4.png", "8.png")
    everything = load_photos(paths, height=16, width=16, max_views=None)
    assert everything.views.images.shape[1] == 12


def test_cameras_choose_by_place(tmp_path):
    paths = [save(tmp_path / f"{i}.png") for i in range(6)]
    cameras = []
    for index, x in enumerate([0.0, 0.1, 0.2, 5.0, 5.1, 0.3]):
        known = camera(f"{index}.png")
        known.cam_from_world[0, 3] = x
        cameras.append(known)
    photos = quietly(
        paths,
        height=16,
        width=16,
        max_views=2,
        cameras=CameraSet(tuple(cameras), tmp_path, "metres"),
    )
    assert photos.names == ("0.png", "4.png")
    assert photos.views.cam_from_world is not None
    torch.testing.assert_close(photos.views.cam_from_world[0, :, 0, 3], torch.tensor([0.0, 5.1]))


def test_cameras_and_depth_are_fitted_with_the_photo_by_hand(tmp_path):
    # 60 x 80 into 30 x 30: scale 1/2, ten of the 40 columns cut; f 40, c (40 / 2 - 5, 15).
    depth = np.full((60, 80), 2000, np.uint16)
    depth[:, :40] = 3000
    Image.fromarray(depth).save(tmp_path / "d.png")
    cameras = (camera("a.jpg", depth_path=tmp_path / "d.png"), camera("b.jpg"))
    paths = [save(tmp_path / "a.jpg"), save(tmp_path / "b.jpg")]
    with pytest.warns(UserWarning, match=r"1 of 2 photos have no depth: b\.jpg"):
        photos = load_photos(
            paths, height=30, width=30, cameras=CameraSet(cameras, tmp_path, "metres")
        )
    views = photos.views
    assert views.intrinsics is not None
    assert views.depths is not None
    expected = torch.tensor([[40.0, 0, 15], [0, 40, 15], [0, 0, 1]])
    torch.testing.assert_close(views.intrinsics[0, 0], expected)
    assert (views.depths[0, 0, :, :15] == 3).all()
    assert (views.depths[0, 0, :, 15:] == 2).all()
    assert (views.depths[0, 1] == 0).all()
    assert (photos.units, photos.intrinsics_source) == ("metres", "cameras")


def test_depth_of_another_shape_than_its_camera_is_an_error(tmp_path):
    Image.fromarray(np.ones((60, 60), np.uint16)).save(tmp_path / "d.png")
    cameras = CameraSet((camera("a.jpg", depth_path=tmp_path / "d.png"),), tmp_path, "metres")
    with pytest.raises(ValueError, match=r"d\.png has 60 x 60 pixels, .* 80 x 60"):
        quietly([save(tmp_path / "a.jpg")], height=16, width=16, cameras=cameras)


def test_a_portrait_photo_with_a_camera_of_the_stored_file_is_turned_with_its_depth(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    path = save(tmp_path / "a.jpg", 60, 80, exif=exif)
    depth = np.full((60, 80), 1000, np.uint16)
    depth[:30] = 2000  # the top of the stored file is the right side of the upright photo
    Image.fromarray(depth).save(tmp_path / "d.png")
    cameras = CameraSet((camera("a.jpg", depth_path=tmp_path / "d.png"),), tmp_path, "metres")
    photos = quietly([path], height=60, width=60, cameras=cameras)
    assert photos.pixel_maps[0].original_height == 80
    assert photos.views.depths is not None
    assert (photos.views.depths[0, 0, :, 30:] == 2).all()
    assert (photos.views.depths[0, 0, :, :30] == 1).all()


def test_no_photo_and_a_damaged_photo_are_errors(tmp_path):
    with pytest.raises(ValueError, match="no photo was given"):
        load_photos([], height=16, width=16)
    paths = [save(tmp_path / f"{i}.jpg", seed=i) for i in range(8)]
    paths[5].write_bytes(paths[5].read_bytes()[:700])
    with pytest.raises(ValueError, match=r"5\.jpg is damaged or cut off"):
        load_photos(paths, height=16, width=16)


def test_the_pixel_limit_can_be_raised_and_is_put_back(tmp_path):
    before = Image.MAX_IMAGE_PIXELS
    path = save(tmp_path / "a.png", 100, 100)
    with pytest.raises(ValueError, match=r"more than the limit of 0\.005; make it smaller"):
        load_photos([path], height=16, width=16, max_pixels=5_000)
    quietly([path], height=16, width=16, max_pixels=10_000)
    assert before == Image.MAX_IMAGE_PIXELS


def test_read_photos_gathers_every_warning(tmp_path):
    (tmp_path / "set").mkdir()
    save(tmp_path / "set" / "a.jpg")
    (tmp_path / "set" / "notes.txt").touch()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        photos = read_photos(tmp_path / "set", height=16, width=16)
    assert len(photos.warnings) == 2
    assert "notes.txt" in photos.warnings[0]
    assert "only one photo" in photos.warnings[1]
    assert [str(warning.message) for warning in caught] == list(photos.warnings)


def test_read_photos_takes_the_path_of_camera_files(tmp_path):
    paths = [save(tmp_path / "images" / f"{i}.jpg", seed=i) for i in range(2)]
    frames = [
        {"file_path": f"images/{path.name}", "transform_matrix": torch.eye(4).tolist()}
        for path in paths
    ]
    data = {"w": 80, "h": 60, "fl_x": 80.0, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    photos = read_photos(tmp_path / "images", height=30, width=30, cameras=tmp_path)
    assert photos.views.cam_from_world is not None
    assert photos.units == "arbitrary"
    assert find_images(tmp_path / "images") == paths
