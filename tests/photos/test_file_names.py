import os
import socket
from pathlib import Path

import pytest

from instok3d.photos.file_names import (
    NamedFiles,
    check_regular_file,
    entry_of_any_case,
    given_path,
    loose_key,
    picture_stem,
    portable,
    read_text,
    shortened,
)


def test_a_leading_tilde_is_home_unless_a_file_has_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("~a.jpg", "~"):
        (tmp_path / name).touch()
        assert given_path(name) == Path(name)
        assert given_path(f"./{name}") == Path(name)
    (tmp_path / "~").unlink()
    assert given_path("~") == tmp_path / "home"
    assert given_path("~/a.jpg") == tmp_path / "home" / "a.jpg"
    assert given_path("~nobody-here.jpg") == Path("~nobody-here.jpg")  # no user of this name
    assert given_path("a/~b.jpg") == Path("a/~b.jpg")


def test_what_never_ends_or_is_not_there_is_refused_at_once(tmp_path):
    check_regular_file(Path(__file__))
    os.mkfifo(tmp_path / "pipe.jpg")
    (tmp_path / "loop.jpg").symlink_to(tmp_path / "loop.jpg")
    (tmp_path / "broken.jpg").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ValueError, match=r"pipe\.jpg is a named pipe, wanted a file"):
        check_regular_file(tmp_path / "pipe.jpg")
    with pytest.raises(ValueError, match="is a device"):
        check_regular_file(Path(os.devnull))
    with pytest.raises(ValueError, match="is a folder"):
        check_regular_file(tmp_path)
    for name in ("loop.jpg", "broken.jpg"):
        with pytest.raises(FileNotFoundError, match=rf"the link .*{name} leads to no file"):
            check_regular_file(tmp_path / name)
    for name in ("none.jpg", 300 * "n"):
        with pytest.raises(FileNotFoundError, match="there is no file"):
            check_regular_file(tmp_path / name)


def test_a_socket_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # addresses of sockets must be short
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("s")
        with pytest.raises(ValueError, match="s is a socket"):
            check_regular_file(Path("s"))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32"])
def test_text_is_read_by_its_byte_order_mark(tmp_path, encoding):
    (tmp_path / "a.txt").write_bytes("ä 居\n".encode(encoding))
    assert read_text(tmp_path / "a.txt") == "ä 居\n"
    (tmp_path / "big.txt").write_bytes(b"\xfe\xff" + "ä".encode("utf-16-be"))
    assert read_text(tmp_path / "big.txt") == "ä"


def test_bytes_that_are_no_text_stay_as_in_file_names(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\xff.jpg")
    assert os.fsencode(read_text(tmp_path / "a.txt")) == b"\xff.jpg"
    (tmp_path / "odd.txt").write_bytes(b"\xff\xfea")
    with pytest.raises(ValueError, match="utf-16"):
        read_text(tmp_path / "odd.txt")
    (tmp_path / "empty.txt").touch()
    assert read_text(tmp_path / "empty.txt") == ""


def test_names_by_hand():
    assert portable("images\\1.jpg") == portable("./images/1.jpg") == "images/1.jpg"
    assert picture_stem("frame.0001") == picture_stem("frame.0001.JPG") == "frame.0001"
    assert picture_stem(".jpg") == ".jpg"
    assert loose_key("A\\Frame.0001.JPEG") == "a/frame.0001"
    assert loose_key("caf\u00e9.png") == loose_key("cafe\u0301.webp")  # one letter or two
    assert shortened([]) == ""
    assert shortened(["a", "b", "c"], most=2) == "a, b and 1 more"


def test_letter_case_counts_only_where_it_must(tmp_path):
    (tmp_path / "Cameras.txt").touch()
    assert entry_of_any_case(tmp_path, "cameras.txt") == tmp_path / "Cameras.txt"
    assert entry_of_any_case(tmp_path, "images.txt") is None
    assert entry_of_any_case(tmp_path / "none", "images.txt") is None
    (tmp_path / "CAMERAS.TXT").touch()
    if len(list(tmp_path.iterdir())) == 2:  # not on disks that ignore it
        with pytest.raises(ValueError, match=r"CAMERAS\.TXT, Cameras\.txt, which differ only in"):
            entry_of_any_case(tmp_path, "cameras.txt")
        (tmp_path / "cameras.txt").touch()
        assert entry_of_any_case(tmp_path, "cameras.txt") == tmp_path / "cameras.txt"


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A folder with photos, and one photo beside it."""
    for name in ("in/a/frame.0001.JPG", "in/a/photo.webp", "in/b.png", "in/b.txt", "out.jpg"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path / "in"


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("a/frame.0001", "a/frame.0001.JPG"),
        ("a\\frame.0001.jpg", "a/frame.0001.JPG"),
        ("./a/PHOTO.jpeg", "a/photo.webp"),
        ("b", "b.png"),
        ("a/../b.png", "b.png"),
        ("a/frame", None),
        ("none/b.png", None),
        ("b.txt", "b.txt"),
    ],
)
def test_photos_are_found_under_what_camera_files_call_them(capture, name, file):
    found = NamedFiles(capture, capture / "cameras.json").photo(name)
    assert (None if found is None else found.resolve()) == (file and (capture / file).resolve())


def test_a_name_with_a_backslash_in_it_goes_first(capture):
    (capture / "a\\photo.jpg").touch()
    files = NamedFiles(capture, capture / "cameras.json")
    assert files.photo("a\\photo.jpg") == capture / "a\\photo.jpg"


def test_photos_that_differ_only_in_their_ending_are_refused(capture):
    (capture / "b.jpg").touch()
    files = NamedFiles(capture, capture / "cameras.json")
    assert files.photo("b.png") == capture / "b.png"
    with pytest.raises(ValueError, match=r"names b, which may be b\.jpg or b\.png .* keep one"):
        files.photo("b")


@pytest.mark.parametrize(
    "name", ["../out.jpg", "a/../../out.jpg", "..\\out.jpg", "/etc/passwd", "C:\\out.jpg",
             "\\\\server\\out.jpg", ".."]
)  # fmt: skip
def test_names_that_lead_out_of_the_folder_are_refused_unless_asked_for(capture, name):
    files = NamedFiles(capture, capture / "cameras.json")
    for find in (files.photo, files.place):
        with pytest.raises(ValueError, match=r"cameras\.json names .* outside .* --allow-outside"):
            find(name)
    NamedFiles(capture, capture / "cameras.json", allow_outside=True).place(name)


def test_what_is_asked_for_may_lie_outside(capture):
    files = NamedFiles(capture, capture / "cameras.json", allow_outside=True)
    assert files.photo("../out") == capture / "../out.jpg"
    inside = NamedFiles(capture, capture / "cameras.json")
    assert inside.photo(str(capture / "b.png")) == capture / "b.png"  # a whole path, but within
