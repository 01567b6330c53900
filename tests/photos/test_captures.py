import json
from pathlib import Path

import pytest

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
