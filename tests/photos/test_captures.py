import json
import warnings
from pathlib import Path

import pytest
import torch

from colmap_models import write_colmap
from instok3d.photos.captures import find_photos_and_cameras
from instok3d.photos.image_files import NoPhotosError

EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def capture(folder: Path, *names: str) -> Path:
    """A transforms.json that names these photos, and the photos (empty: nobody decodes them)."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    frames = [{"file_path": name, "transform_matrix": EYE} for name in names]
    table = {"w": 80, "h": 60, "fl_x": 70.0, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(table))
    return folder


def test_a_folder_without_photos_of_its_own_gives_those_that_its_cameras_name(tmp_path):
    folder = capture(tmp_path, "color/b.jpg", "color/a.jpg")
    photos, cameras = find_photos_and_cameras(folder)
    assert photos == [tmp_path / "color" / "b.jpg", tmp_path / "color" / "a.jpg"]
    assert cameras is not None
    assert [camera.name for camera in cameras.of(photos)] == ["color/b.jpg", "color/a.jpg"]
    by_file, _ = find_photos_and_cameras(str(folder / "transforms.json"))
    assert by_file == photos
    given, cameras = find_photos_and_cameras(folder, folder / "transforms.json")
    assert given == photos
    assert cameras is not None


def test_names_may_lack_their_ending_and_the_folder_images(tmp_path):
    folder = capture(tmp_path, "1.png", "2.jpg")
    (folder / "images").mkdir()
    (folder / "1.png").rename(folder / "images" / "1.png")
    (folder / "2.jpg").rename(folder / "images" / "2.jpg")
    file = folder / "transforms.json"
    file.write_text(file.read_text().replace("1.png", "1"))
    photos, _ = find_photos_and_cameras(folder)
    assert photos == [tmp_path / "images" / "1.png", tmp_path / "images" / "2.jpg"]


def test_photos_of_the_folder_itself_go_first(tmp_path):
    folder = capture(tmp_path, "1.jpg", "2.jpg")
    (folder / "3.jpg").touch()
    with pytest.warns(UserWarning, match=r"transforms\.json"):
        photos, cameras = find_photos_and_cameras(folder)
    assert [photo.name for photo in photos] == ["1.jpg", "2.jpg", "3.jpg"]
    assert cameras is None


def quietly(*arguments, **options) -> list[str]:
    """The names of the photos, without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        photos, cameras = find_photos_and_cameras(*arguments, **options)
    assert cameras is not None
    assert len(cameras.of(photos)) == len(photos)
    return [photo.name for photo in photos]


@pytest.mark.parametrize("ending", ["jpg", "JPG", "jpeg", "webp", "png"])
@pytest.mark.parametrize("form", ["./images/{}", "images/{}", "images\\{}", "{}"])
def test_photos_are_found_under_names_without_ending_in_any_form(tmp_path, ending, form):
    stems = ["photo_1", "frame.0001", "IMG 2"]
    folder = capture(tmp_path, *(form.format(stem) for stem in stems))
    (tmp_path / "images").mkdir(exist_ok=True)
    for path in [path for path in tmp_path.rglob("*") if path.is_file() and path.suffix != ".json"]:
        path.unlink()
    for stem in stems:
        (folder / "images" / f"{stem}.{ending}").touch()
    assert quietly(folder) == [f"{stem}.{ending}" for stem in stems]


def test_photos_that_no_camera_names_are_told(tmp_path):
    folder = capture(tmp_path, "images/1.jpg", "images/a/2.jpg")
    for name in ("images/3.jpg", "images/a/4.JPG", "images/b/5.png", "images_4/6.jpg", "7.txt"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()
    with pytest.warns(UserWarning, match="no camera") as caught:
        photos, _ = find_photos_and_cameras(folder)
    assert [photo.name for photo in photos] == ["1.jpg", "2.jpg"]
    (message,) = [str(warning.message) for warning in caught]
    assert "3 of 5 photos" in message
    assert message.endswith("left out: images/3.jpg, images/a/4.JPG, images/b/5.png")


def test_of_photos_beside_the_camera_file_the_others_are_told_too(tmp_path):
    folder = capture(tmp_path, "1.jpg", "2.jpg")
    (folder / "3.jpg").touch()
    with pytest.warns(UserWarning, match=r"1 of 3 photos .* left out: 3\.jpg"):
        photos, _ = find_photos_and_cameras(folder / "transforms.json")
    assert len(photos) == 2


def test_depth_and_links_to_the_same_photo_are_not_missed(tmp_path):
    folder = capture(tmp_path, "frames/1.jpg")
    table = json.loads((folder / "transforms.json").read_text())
    table["frames"][0]["depth_file_path"] = "frames/1_depth.png"
    (folder / "transforms.json").write_text(json.dumps(table))
    (folder / "frames/1_depth.png").touch()
    (folder / "frames/link.jpg").symlink_to(folder / "frames/1.jpg")
    assert quietly(folder) == ["1.jpg"]


def test_the_largest_colmap_model_of_a_capture_is_used(tmp_path):
    lens = {1: ("PINHOLE", 80, 60, [70.0, 70.0, 40.0, 30.0])}
    images = [(f"{k}.jpg", torch.eye(4).double(), 1) for k in range(6)]
    write_colmap(tmp_path / "sparse/0", lens, images[:2], ".bin")
    write_colmap(tmp_path / "sparse/1", lens, images[1:5], ".bin")
    (tmp_path / "images").mkdir()
    for name, _, _ in images:
        (tmp_path / "images" / name).touch()
    with pytest.warns(UserWarning, match=r"left out|leaves out") as caught:
        photos, _ = find_photos_and_cameras(tmp_path)
    assert [photo.name for photo in photos] == ["1.jpg", "2.jpg", "3.jpg", "4.jpg"]
    models, unnamed = sorted(str(warning.message) for warning in caught)[::-1]
    if "COLMAP models" not in models:
        models, unnamed = unnamed, models
    assert "sparse/1 is used, which leaves out 1 photos: 0.jpg" in models
    assert "2 of 6 photos" in unnamed
    given, _ = find_photos_and_cameras(tmp_path / "images/0.jpg", tmp_path / "sparse/0")
    assert [photo.name for photo in given] == ["0.jpg"]


@pytest.mark.parametrize("name", ["../out.jpg", "{}/out.jpg", "..\\out.jpg"])
def test_photos_outside_of_the_folder_must_be_asked_for(tmp_path, name):
    folder = capture(tmp_path / "in", "1.jpg")
    (tmp_path / "out.jpg").touch()
    (tmp_path / "bystander.jpg").touch()
    (folder / "1.jpg").unlink()
    table = json.loads((folder / "transforms.json").read_text())
    table["frames"][0]["file_path"] = name.format(tmp_path)
    (folder / "transforms.json").write_text(json.dumps(table))
    with pytest.raises(ValueError, match=r"names .*out\.jpg, which lies outside .*--allow-outside"):
        find_photos_and_cameras(folder)
    assert quietly(folder, allow_outside=True) == ["out.jpg"]
    # A photo that the user names is found in the camera file by its name alone.
    photos, cameras = find_photos_and_cameras(tmp_path / "out.jpg", folder)
    assert cameras is not None
    assert len(cameras.of(photos)) == 1


def test_cameras_that_are_not_used_are_pointed_out(tmp_path):
    folder = capture(tmp_path, "1.jpg")
    with pytest.warns(UserWarning, match=r"transforms\.json") as caught:
        _, cameras = find_photos_and_cameras(folder)
    assert cameras is None
    assert any("pass --cameras" in str(warning.message) for warning in caught)


def test_what_is_missing_is_named(tmp_path):
    (tmp_path / "color").mkdir()
    (tmp_path / "color" / "1.jpg").touch()
    with pytest.raises(NoPhotosError, match="give one of its folders: color"):
        find_photos_and_cameras(tmp_path)
    folder = capture(tmp_path, "color/1.jpg", "color/2.jpg")
    (folder / "color" / "2.jpg").unlink()
    with pytest.raises(FileNotFoundError, match=r"names the photo color/2\.jpg, which is not in"):
        find_photos_and_cameras(folder)
    with pytest.raises(NoPhotosError, match="the pattern"):
        find_photos_and_cameras(f"{tmp_path}/*.json")
    with pytest.raises(FileNotFoundError, match="there is no file or folder"):
        find_photos_and_cameras(tmp_path / "nowhere.json")
