import os
import warnings
from pathlib import Path

import pytest

from instok3d.photos.image_files import find_images


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


@pytest.fixture(autouse=True)
def warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_a_folder_comes_in_natural_order(tmp_path):
    touch(tmp_path, "b10.jpg", "b2.jpg", "a.PNG", "B1.jpeg", "ä 3.webp")
    assert names(find_images(tmp_path)) == ["a.PNG", "B1.jpeg", "b2.jpg", "b10.jpg", "ä 3.webp"]
    assert find_images(str(tmp_path)) == find_images(tmp_path)


def test_what_is_left_out_of_a_folder_is_counted_and_named(tmp_path):
    touch(tmp_path, "1.jpg", ".hidden.jpg", "1_thumb.jpg", "Thumbs.db", "notes.txt", "more/2.jpg")
    with pytest.warns(UserWarning, match="5 of 6 entries") as caught:
        found = find_images(tmp_path)
    assert names(found) == ["1.jpg"]
    for name in (".hidden.jpg", "1_thumb.jpg", "Thumbs.db", "notes.txt", "more"):
        assert name in str(caught[0].message)


def test_many_left_out_names_are_shortened(tmp_path):
    touch(tmp_path, "1.jpg", *(f"{i}.txt" for i in range(9)))
    with pytest.warns(UserWarning, match=r"0\.txt, .* 4\.txt and 4 more"):
        find_images(tmp_path)


def test_a_thumb_in_a_longer_word_is_a_photo(tmp_path):
    touch(tmp_path, "thumbelina.jpg", "my-thumbs-up.jpg")
    with pytest.warns(UserWarning, match="1 of 2"):
        assert names(find_images(tmp_path)) == ["thumbelina.jpg"]


def test_a_pattern_finds_files_in_natural_order(tmp_path):
    touch(tmp_path, "p9.jpg", "p10.jpg", "q1.jpg", "x/p1.jpg")
    assert names(find_images(str(tmp_path / "p*.jpg"))) == ["p9.jpg", "p10.jpg"]
    assert names(find_images(str(tmp_path / "**" / "p1.jpg"))) == ["p1.jpg"]


def test_a_name_with_brackets_is_a_file_before_it_is_a_pattern(tmp_path):
    touch(tmp_path, "a[1].jpg", "set [2]/x.jpg")
    assert names(find_images(tmp_path / "a[1].jpg")) == ["a[1].jpg"]
    assert names(find_images(tmp_path / "set [2]")) == ["x.jpg"]


def test_a_list_keeps_its_order(tmp_path):
    touch(tmp_path, "1.jpg", "2.jpg")
    assert names(find_images([tmp_path / "2.jpg", str(tmp_path / "1.jpg")])) == ["2.jpg", "1.jpg"]


def test_a_file_that_is_given_twice_is_used_once_and_told(tmp_path):
    touch(tmp_path, "1.jpg", "2.jpg")
    given = [tmp_path / "2.jpg", tmp_path / "1.jpg", tmp_path / "2.jpg"]
    with pytest.warns(UserWarning, match="1 of 3 files were given twice"):
        assert names(find_images(given)) == ["2.jpg", "1.jpg"]


def test_a_link_to_itself_is_left_out(tmp_path):
    touch(tmp_path, "1.jpg")
    (tmp_path / "loop.jpg").symlink_to(tmp_path / "loop.jpg")
    with pytest.warns(UserWarning, match=r"loop\.jpg"):
        assert names(find_images(tmp_path)) == ["1.jpg"]


def test_names_that_begin_with_a_tilde_are_files(tmp_path, monkeypatch):
    touch(tmp_path, "~photo_1.jpg", "~photo_2.jpg", "~folder/1.jpg")
    monkeypatch.chdir(tmp_path)
    for name in ("~photo_1.jpg", "./~photo_1.jpg"):
        assert names(find_images(name)) == ["~photo_1.jpg"]
    assert names(find_images(["~photo_2.jpg", "~photo_1.jpg"])) == ["~photo_2.jpg", "~photo_1.jpg"]
    assert names(find_images("~folder")) == ["1.jpg"]
    assert names(find_images("~photo_*.jpg")) == ["~photo_1.jpg", "~photo_2.jpg"]
    with pytest.raises(FileNotFoundError, match=r"no file or folder ~photo_9\.jpg"):
        find_images("~photo_9.jpg")
    with pytest.raises(FileNotFoundError, match=r"no file ~photo_9\.jpg"):
        find_images(["~photo_1.jpg", "~photo_9.jpg"])


def test_a_pattern_does_not_follow_folders_that_go_round_in_a_circle(tmp_path):
    touch(tmp_path, "1.jpg", "a/2.jpg", "a/b/3.jpg", "a/.hidden/4.jpg")
    (tmp_path / "a/first").symlink_to(tmp_path)
    (tmp_path / "a/second").symlink_to(tmp_path)  # two of them would make 2^40 paths
    for pattern in ("**/*.jpg", "**/**/*.jpg"):
        assert names(find_images(str(tmp_path / pattern))) == ["1.jpg", "2.jpg", "3.jpg"]
    assert names(find_images(f"{tmp_path}/a/first/*.jpg")) == ["1.jpg"]
    assert names(find_images(f"{tmp_path}/a/[!.]/*.jpg")) == ["3.jpg"]


def test_a_relative_pattern_starts_here(tmp_path, monkeypatch):
    touch(tmp_path, "x/1.jpg", "x/2.png", "y/3.jpg")
    monkeypatch.chdir(tmp_path)
    assert find_images("*/*.jpg") == [Path("x/1.jpg"), Path("y/3.jpg")]
    assert names(find_images(f"../{tmp_path.name}/*/?.jpg")) == ["1.jpg", "3.jpg"]


@pytest.mark.parametrize("kind", [str, lambda path: [path]])
def test_pipes_and_devices_are_refused_at_once(tmp_path, kind):
    os.mkfifo(tmp_path / "pipe.jpg")
    with pytest.raises(ValueError, match=r"pipe\.jpg is a named pipe, wanted a file"):
        find_images(kind(str(tmp_path / "pipe.jpg")))
    with pytest.raises(ValueError, match="is a device, wanted a file"):
        find_images(kind(os.devnull))
    touch(tmp_path, "1.jpg")
    with pytest.warns(UserWarning, match=r"left out: pipe\.jpg"):
        assert names(find_images(tmp_path)) == ["1.jpg"]


def test_a_link_that_leads_nowhere_is_named(tmp_path):
    (tmp_path / "a.jpg").symlink_to(tmp_path / "gone.jpg")
    with pytest.raises(FileNotFoundError, match=r"the link .*a\.jpg leads to no file"):
        find_images(tmp_path / "a.jpg")


def test_names_that_are_no_text_and_long_ones_are_found(tmp_path):
    odd = os.fsdecode(b"\xff.jpg")
    touch(tmp_path, odd, 245 * "n" + ".jpg")
    assert sorted(names(find_images(tmp_path))) == sorted([245 * "n" + ".jpg", odd])


def test_nothing_there_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no file or folder .*nowhere"):
        find_images(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match=r"no file matches the pattern .*\*\.jpg"):
        find_images(str(tmp_path / "*.jpg"))
    with pytest.raises(FileNotFoundError, match=r"no file .*a\.jpg"):
        find_images([tmp_path / "a.jpg"])
    with pytest.raises(ValueError, match="list of files is empty"):
        find_images([])


def test_a_folder_without_photos_says_what_it_holds(tmp_path):
    with pytest.raises(ValueError, match="holds no photo; it is empty"):
        find_images(tmp_path)
    touch(tmp_path, "a.txt")
    with pytest.raises(ValueError, match=r"holds no photo, only a\.txt"):
        find_images(tmp_path)
    touch(tmp_path, "walk.MP4")
    with pytest.raises(ValueError, match=r"give a video in it as the input: walk\.MP4"):
        find_images(tmp_path)
    touch(tmp_path, "images/1.jpg", "empty/.x")
    with pytest.raises(ValueError, match=r"give one of its folders: images$"):
        find_images(tmp_path)


def test_a_folder_in_a_list_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="holds the folder"):
        find_images([tmp_path])


def test_a_folder_that_may_not_be_listed_is_named(tmp_path, monkeypatch):
    def refuse(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(PermissionError, match=r"folder .* may not be listed"):
        find_images(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads all")
def test_a_forbidden_folder_is_named(tmp_path):
    tmp_path.chmod(0)
    try:
        with pytest.raises(PermissionError, match=r"folder .* may not be listed"):
            find_images(tmp_path)
    finally:
        tmp_path.chmod(0o700)
