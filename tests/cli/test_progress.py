"""Progress of commands: on stderr, in place on a terminal, and never in what --json prints."""

import json
from pathlib import Path

import pytest

from instok3d.cli import main
from instok3d.cli.progress import StageClock
from made_model import made_model, made_photos
from terminal import on_terminal


@pytest.mark.parametrize("terminal", [False, True])
def test_json_is_all_that_stands_on_stdout(
    terminal: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    model = made_model(tmp_path / "model.safetensors")
    photos = made_photos(tmp_path / "photos")
    words = ["reconstruct", str(photos), "-o", str(tmp_path / "room.itk"), "--model", str(model)]
    stream = on_terminal(monkeypatch) if terminal else None
    assert main([*words, "--json"]) == 0
    shown = capsys.readouterr()
    assert {"geometry", "tokens", "previews"} <= json.loads(shown.out)["timings_s"].keys()
    lines = stream.drawn if stream else shown.err.splitlines()
    assert "geometry ..." in lines
    assert lines[-1].startswith("done in 0m")
    assert ("previews: contact sheet ..." if terminal else "previews ...") in lines


def test_how_far_a_stage_is_counts_as_the_same_stage(capsys: pytest.CaptureFixture[str]):
    clock = StageClock()
    with clock.running():
        clock.begin("previews: object 1 of 2")
        clock.begin("previews: object 2 of 2")
        clock.begin("save")
    assert list(clock.times_s) == ["previews", "save"]
    assert capsys.readouterr().err == "previews ...\nsave ...\n"
    assert clock.report().splitlines()[-1].split()[0] == "all"


def test_an_error_takes_the_status_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    stream = on_terminal(monkeypatch)
    assert main(["reconstruct", str(tmp_path / "none"), "-o", str(tmp_path / "room.itk")]) == 2
    assert stream.drawn[-1].startswith("instok3d: ")
