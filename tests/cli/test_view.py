"""`instok3d view` as people type it."""

import http.client
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from instok3d.cli import main
from instok3d.scene.scene import Scene
from made_scene import made_scene, made_tokens
from patience import SECONDS


@pytest.fixture
def room(tmp_path: Path) -> Path:
    made_scene(made_tokens()).save(tmp_path / "room.itk")
    return tmp_path / "room.itk"


def test_it_prints_an_address_that_opens_and_ends_well_by_ctrl_c(room: Path):
    pytest.importorskip("viser", reason="needs viser: '.[view]'")
    words = [sys.executable, "-m", "instok3d", "view", str(room), str(room), "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        url = urlsplit(run.stdout.readline().strip())
        assert (url.scheme, url.hostname) == ("http", "127.0.0.1")
        assert run.stdout.readline() == "Ctrl-C ends the viewer\n"
        for target, status in ((f"/?{url.query}", 303), ("/", 403)):
            connection = http.client.HTTPConnection("127.0.0.1", url.port or 0, timeout=SECONDS)
            connection.request("GET", target)
            assert connection.getresponse().status == status
            connection.close()
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=SECONDS)
    assert run.returncode == 0, err
    assert (out, err) == ("", "")
    assert Scene.load(room).edits == ()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no scene was named: give a scene folder"),
        (["nowhere.itk"], "nowhere.itk"),
        (["ROOM", "nowhere.itk"], "nowhere.itk"),
        (["ROOM", "--host", "0.0.0.0"], "--host 0.0.0.0 lets other machines in: give a --token"),
        (["ROOM", "--token", "short"], "the token must be 16 to 128 letters"),
        (
            ["ROOM", "--upload-limit", "-1"],
            "--upload-limit must be megabytes, 0 (no uploads) or mo",
        ),
        (["ROOM", "--upload-limit", "nan"], "or more, got nan"),
        (["ROOM", "--port", "70000"], "port must be 0 (any) or up to 65535, got 70000"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    room: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
):
    pytest.importorskip("viser", reason="needs viser: '.[view]'")
    assert main(["view", *(str(room) if word == "ROOM" else word for word in words)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1


def test_without_viser_it_says_what_to_install(
    room: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(room)]) == 2
    assert "pip install 'instok3d[view]'" in capsys.readouterr().err
