import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

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
    with pytest.raises(ValueError, match=r"a\.mp4 .* pip install 'instok3d\[video\]'"):
        find_images(tmp_path / "a.mp4")


def test_one_frame_of_the_video_is_one_flat_grey(video, tmp_path):
    (frame,) = extract_frames(video, tmp_path, count=1)
    image = decode_photo(frame, height=8, width=8).image
    assert image.std() < 0.02


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    """Six photos whose brightness rises."""
    folder = tmp_path_factory.mktemp("photos")
    for index in range(6):
        Image.new("RGB", (96, 64), 3 * (40 * index,)).save(folder / f"{index}.jpg", quality=95)
    return folder


def written_by_ffmpeg(photos: Path, path: Path, *options: str) -> Path:
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    source = ["-v", "error", "-framerate", "4", "-i", str(photos / "%d.jpg")]
    words = [program, *source, "-pix_fmt", "yuv420p", *options, str(path)]
    if subprocess.run(words, capture_output=True).returncode != 0:
        pytest.skip(f"this ffmpeg cannot write {path.name}")
    return path


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.ts", ()),
        ("a.MTS", ("-f", "mpegts")),
        ("a.m2ts", ("-f", "mpegts", "-c:v", "mpeg2video")),
        ("a.3gp", ("-c:v", "mpeg4")),
        ("a.mpg", ("-r", "25")),
        ("a.flv", ("-c:v", "flv")),
        ("a.wmv", ()),
        ("a.nut", ("-c:v", "mpeg4")),  # in no list of endings
        ("a.0001", ("-f", "matroska", "-c:v", "mpeg4")),
        ("a", ("-f", "mov", "-c:v", "mpeg4")),
        ("a.txt", ("-f", "avi", "-c:v", "mpeg4")),
    ],
)
def test_a_video_is_known_by_its_bytes(photos, tmp_path, name, options):
    video = written_by_ffmpeg(photos, tmp_path / name, *options)
    (tmp_path / "frames").mkdir()
    frames = find_images(video, frames_folder=tmp_path / "frames")
    assert 6 <= len(frames) <= 48
    brightness = [float(np.asarray(Image.open(frame)).mean()) for frame in frames]
    assert brightness[0] < 20
    assert brightness[-1] > 180
    assert np.diff(brightness).min() > -3


def test_a_picture_is_known_by_its_bytes_too(tmp_path):
    for name in ("a.mp4", "photo", "frame.0001"):
        Image.new("RGB", (8, 8)).save(tmp_path / name, format="JPEG")
        assert find_images(tmp_path / name) == [tmp_path / name]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.txt", "no video\n" * 99),  # ffmpeg would draw the letters
        ("a.m3u8", "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nsecret.ts\n#EXT-X-ENDLIST\n"),
        ("a.ffconcat", "ffconcat version 1.0\nfile secret.ts\n"),
        ("a.srt", "1\n00:00:00,000 --> 00:00:01,000\nhello\n"),
    ],
)
def test_text_and_lists_that_lead_to_other_files_are_no_videos(photos, tmp_path, name, text):
    written_by_ffmpeg(photos, tmp_path / "secret.ts")
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=rf"{name} is not a video that ffmpeg can read, nor"):
        find_images(tmp_path / name)


def test_without_the_plugin_an_unknown_file_is_perhaps_a_video(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    (tmp_path / "a.xyz").write_bytes(b"0123456789")
    with pytest.raises(ValueError, match=r"a\.xyz is no picture .* install 'instok3d\[video\]'"):
        find_images(tmp_path / "a.xyz")
