import sys

import numpy as np
import pytest

from instok3d.photos.image_decoding import decode_photo
from instok3d.photos.image_files import find_images
from instok3d.photos.loading import read_photos
from instok3d.photos.video import extract_frames


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Two seconds at 10 frames a second whose brightness rises from 0 to 190."""
    imageio = pytest.importorskip("imageio.v2")
    pytest.importorskip("imageio_ffmpeg")
    path = tmp_path_factory.mktemp("video") / "walk round.mp4"
    frames = [np.full((64, 96, 3), 10 * index, np.uint8) for index in range(20)]
    imageio.mimwrite(path, frames, fps=10, macro_block_size=16)
    return path


def test_frames_are_spread_over_the_whole_video_in_order(video):
    photos = read_photos(video, height=16, width=16, max_views=None)
    brightness = photos.views.images[0].mean(dim=(1, 2, 3)) * 255
    assert brightness.diff().min() >= -1
    assert brightness[0] < 10
    assert brightness[-1] > 170
    assert photos.pixel_maps[0].original_width == 96


def test_the_wanted_number_of_frames_comes_out(video, tmp_path):
    frames = extract_frames(video, tmp_path, count=5)
    assert len(frames) == 5
    assert frames == sorted(tmp_path.iterdir())


def test_frames_go_to_the_given_folder(video, tmp_path):
    frames = find_images(video, frames_folder=tmp_path)
    assert {frame.parent for frame in frames} == {tmp_path}


def test_twice_the_same_video_gives_the_same_frames(video, tmp_path):
    first = [path.read_bytes() for path in find_images(video)]
    assert first == [path.read_bytes() for path in find_images(video, frames_folder=tmp_path)]


def test_text_named_mp4_is_an_error(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / "a.mp4").write_text("no video")
    with pytest.raises(ValueError, match=r"a\.mp4 is not a video that ffmpeg can read"):
        extract_frames(tmp_path / "a.mp4", tmp_path)


def test_without_the_plugin_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    (tmp_path / "a.mp4").touch()
    with pytest.raises(ValueError, match=r"a\.mp4 .* pip install instok3d\[video\]"):
        find_images(tmp_path / "a.mp4")


def test_one_frame_of_the_video_is_one_flat_grey(video, tmp_path):
    (frame,) = extract_frames(video, tmp_path, count=1)
    image = decode_photo(frame, height=8, width=8).image
    assert image.std() < 0.02
