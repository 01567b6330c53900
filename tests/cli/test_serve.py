"""`instok3d serve` as people type it."""

import http.client
import json
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from instok3d.cli import main
from instok3d.cli.serve import named_scenes, opened
from instok3d.semantics.query import shipped
from instok3d.service.library_tools import LibraryTools
from made_encoder import made_room, write_encoder
from made_scene import made_scene, made_tokens
from patience import SECONDS


@pytest.fixture
def room(tmp_path: Path) -> Path:
    made_scene(made_tokens()).save(tmp_path / "room.itk")
    return tmp_path / "room.itk"


def test_it_prints_an_address_that_answers_and_ends_well_by_ctrl_c(room: Path):
    pytest.importorskip("mcp", reason="needs mcp: '.[serve]'")
    words = [sys.executable, "-m", "instok3d", "serve", str(room), "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        url = urlsplit(run.stdout.readline().strip())
        lines = [run.stdout.readline().strip() for _ in range(3)]
        assert lines[0] == f"http://{url.netloc}/mcp"
        assert lines[1].startswith("Authorization: Bearer ")
        for query, status in ((url.query, 200), ("", 403)):
            connection = http.client.HTTPConnection("127.0.0.1", url.port or 0, timeout=SECONDS)
            connection.request("GET", f"/api/list_scenes?{query}")
            response = connection.getresponse()
            body = json.loads(response.read())
            assert response.status == status, body
            connection.close()
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=SECONDS)
    assert run.returncode == 0, err
    assert (out, err) == ("", "")


def test_scenes_of_one_name_are_told_apart(tmp_path: Path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        made_scene(made_tokens()).save(tmp_path / folder / "room.itk")
    places = [tmp_path / folder / "room.itk" for folder in ("one", "two")]
    assert list(named_scenes(places)) == ["room.itk", "room.itk-2"]


def test_a_library_and_scenes_are_served_together(
    tmp_path: Path, room: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):  # fmt: skip
    teacher = write_encoder(tmp_path / "encoder.safetensors")
    made_room(teacher).save(tmp_path / "seen.itk")
    library = tmp_path / "rooms.lib"
    assert main(["library", "add", str(library), str(tmp_path / "seen.itk")]) == 0
    capsys.readouterr()
    alone = opened((library,), f"rooms:{tmp_path / 'encoder.safetensors'}")
    assert [tool.name for each in alone for tool in each.tools()][:2] == [
        "library_scenes", "library_query",
    ]  # fmt: skip
    assert isinstance(alone[0], LibraryTools)
    assert len(alone[0].query("chair", 5)["matches"]) == 2
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(shipped, "SHIPPED", tmp_path / "none.safetensors")
    both = opened((library, room), None)
    assert len({tool.name for each in both for tool in each.tools()}) == 14
    assert "note: the library cannot be searched: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no scene was named: give scene folders"),
        (["nowhere.itk"], "nowhere.itk"),
        (["ROOM", "--teacher", "rooms:x"], "--teacher is for questions to a library, and none"),
        (["ROOM", "--host", "0.0.0.0"], "--host 0.0.0.0 lets other machines in: give a --token"),
        (["ROOM", "--token", "short"], "the token must be 16 to 128 letters"),
        (["ROOM", "--port", "70000"], "port must be 0 (any) or up to 65535, got 70000"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    room: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
):
    pytest.importorskip("mcp", reason="needs mcp: '.[serve]'")
    assert main(["serve", *(str(room) if word == "ROOM" else word for word in words)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1


def test_without_mcp_it_says_what_to_install(
    room: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(sys.modules, "mcp", None)
    assert main(["serve", str(room)]) == 2
    assert "pip install 'instok3d[serve]'" in capsys.readouterr().err
