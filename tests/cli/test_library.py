import json
from pathlib import Path

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.cli import main
from instok3d.semantics.query.encoder import QueryEncoder
from made_scene import made_scene, made_tokens

DIRECTIONS = {"first": 0, "second": 1, "third": 2}


class MadeTeacher:
    """Knows three words, which are the axes of the made scene's features."""

    name = "made-3"
    channels = 3

    def text(self, texts: list[str]) -> Float[Tensor, "text channel"]:
        return torch.eye(3)[[DIRECTIONS[each] for each in texts]]

    def features(self, images: Float[Tensor, "view 3 h w"]) -> Float[Tensor, "view 3 h w"]:
        return images

    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " channel"]:
        return image.mean(dim=(1, 2))


@pytest.fixture(autouse=True)
def teacher(monkeypatch: pytest.MonkeyPatch) -> MadeTeacher:
    made = MadeTeacher()
    monkeypatch.setattr("instok3d.semantics.teachers.open_teacher", lambda text: made)
    return made


@pytest.fixture
def rooms(tmp_path: Path) -> list[str]:
    for name in ("a.itk", "b.itk"):
        made_scene(made_tokens()).save(tmp_path / name)
    return [str(tmp_path / "a.itk"), str(tmp_path / "b.itk")]


@pytest.fixture
def library(tmp_path: Path, rooms: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    place = str(tmp_path / "lib")
    assert main(["library", "add", place, *rooms]) == 0
    assert capsys.readouterr().out.splitlines() == [f"{each}: 2 objects" for each in rooms]
    return place


def said(capsys: pytest.CaptureFixture[str]) -> dict:
    return json.loads(capsys.readouterr().out)


def test_objects_of_all_scenes_are_found_by_text(
    library: str, rooms: list[str], capsys: pytest.CaptureFixture[str]
):
    # Group 0 lies along the first axis, group 2 along the third: objects 1 and 3.
    assert (
        main(["library", "query", library, "third", "--teacher", "x:y", "-k", "2", "--json"]) == 0
    )
    matches = said(capsys)["matches"]
    assert [(each["scene"], each["id"]) for each in matches] == [(rooms[0], 3), (rooms[1], 3)]
    assert matches[0]["score"] > 0.8
    assert main(["library", "query", library, "first", "--teacher", "x:y"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0].split()[0] == "1"
    assert lines[0].endswith(rooms[0])


def test_the_encoder_that_is_shipped_needs_no_name(
    library: str, teacher: MadeTeacher, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):  # fmt: skip
    monkeypatch.setattr(
        "instok3d.semantics.query.shipped.shipped_encoder",
        lambda names: QueryEncoder(teacher) if names == ["made-3"] else None,
    )
    assert main(["library", "query", library, "third", "--json"]) == 0
    assert said(capsys)["matches"][0]["id"] == 3


def test_objects_are_found_by_picture(
    library: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    from PIL import Image

    Image.new("RGB", (8, 6), (0, 0, 255)).save(tmp_path / "blue.png")
    arguments = ["--image", str(tmp_path / "blue.png"), "--teacher", "x:y", "--json"]
    assert main(["library", "query", library, *arguments]) == 0
    assert said(capsys)["matches"][0]["id"] == 3


def test_thumbnails_are_written(library: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "found"
    arguments = ["--teacher", "x:y", "--thumbnails", str(folder)]
    assert main(["library", "query", library, "first", *arguments]) == 0
    assert sorted(each.name for each in folder.iterdir()) == [f"00{n}.jpg" for n in range(1, 5)]
    assert main(["library", "query", library, "first", *arguments]) == 2
    assert "is already there" in capsys.readouterr().err


def test_scenes_are_listed_and_removed_by_the_name_they_were_added_by(
    library: str, rooms: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):  # fmt: skip
    assert main(["library", "list", library, "--json"]) == 0
    found = said(capsys)
    assert found["encoder"] == {"name": "made-3", "channels": 3}
    assert found["scenes"] == [{"scene": each, "objects": 2} for each in rooms]
    monkeypatch.chdir(tmp_path)
    assert main(["library", "remove", library, "a.itk"]) == 0
    assert main(["library", "list", library]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "2 objects of 1 scenes, encoder made-3"
    assert main(["library", "compact", library]) == 0
    assert main(["library", "verify", library]) == 0
    assert "2 objects of 1 scenes" in capsys.readouterr().out
    assert main(["library", "remove", library, "a.itk"]) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either a text"),
        (["first", "--image", "x.png"], "give either a text"),
        ([" ", "--teacher", "x:y"], "the text is empty"),
        (["first", "--teacher", "x:y", "-k", "0"], "-k must be at least 1"),
        (["first"], "name its weights with --teacher, one of lseg:FILE"),
        (["--image", "nowhere.png", "--teacher", "x:y"], "nowhere.png"),
    ],
)
def test_bad_questions_are_refused(
    library: str, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
):
    assert main(["library", "query", library, *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


def test_a_picture_that_is_none_is_refused(
    library: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "no.png").write_text("no picture")
    arguments = ["--image", str(tmp_path / "no.png"), "--teacher", "x:y"]
    assert main(["library", "query", library, *arguments]) == 2
    assert "no.png" in capsys.readouterr().err


def test_another_encoder_or_version_is_refused(
    library: str, teacher: MadeTeacher, capsys: pytest.CaptureFixture[str]
):
    teacher.name = "made-4"
    assert main(["library", "query", library, "first", "--teacher", "x:y"]) == 2
    assert "of the encoder 'made-3' (3 channels), not of 'made-4'" in capsys.readouterr().err


def test_what_is_no_library_or_no_scene_is_refused_and_nothing_is_made(
    tmp_path: Path, rooms: list[str], capsys: pytest.CaptureFixture[str]
):
    place = str(tmp_path / "new")
    assert main(["library", "query", place, "first", "--teacher", "x:y"]) == 2
    assert "there is no library" in capsys.readouterr().err
    assert main(["library", "add", place, str(tmp_path / "nowhere.itk")]) == 2
    assert main(["library", "add", place]) == 2
    assert "no scene was named" in capsys.readouterr().err
    assert main(["library", "add", place, rooms[0], "--encoder", "other"]) == 2
    assert "no semantics of 'other'; it has those of made-3" in capsys.readouterr().err
    assert not Path(place).exists()
