import runpy
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest

from instok3d.formats.ply import read_ply
from made_model import made_model, made_photos
from made_scene import made_scene, made_tokens

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(monkeypatch: pytest.MonkeyPatch, name: str, *arguments: Path) -> None:
    monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_reconstruct(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    model = made_model(tmp_path / "model.safetensors")
    for module in ("instok3d.scene.reconstruct", "instok3d.model.files"):
        monkeypatch.setattr(f"{module}.DEFAULT_MODEL", model)
    with pytest.warns(UserWarning, match="its results on real photos are poor"):
        run(monkeypatch, "00_reconstruct.py", made_photos(tmp_path / "in"), tmp_path / "a.itk")
    assert (tmp_path / "a.itk/scene.json").is_file()
    assert "objects" in capsys.readouterr().out


def test_render_and_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    made_scene(made_tokens()).save(tmp_path / "room.itk")
    run(monkeypatch, "01_render.py", tmp_path / "room.itk", tmp_path / "between.png")
    assert (tmp_path / "between.png").is_file()
    run(monkeypatch, "02_export.py", tmp_path / "room.itk", tmp_path / "objects")
    assert len(read_ply(tmp_path / "objects/003.ply").gaussians.means) == 8
    assert "object#3: 8 Gaussians" in capsys.readouterr().out


def test_edit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    made_scene(made_tokens()).save(tmp_path / "room.itk")
    run(monkeypatch, "03_edit.py", tmp_path / "room.itk", tmp_path / "edited.itk")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "remove object#3"
    assert lines[1].startswith("move object#1 by (0.1, ")
    assert len(lines) == 2


@pytest.mark.filterwarnings("ignore:.*results on real photos are poor")
def test_without_arguments_they_make_the_scene_of_the_demo_once_and_say_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    model, photos = made_model(tmp_path / "model.safetensors"), made_photos(tmp_path / "in")
    for module in ("instok3d.scene.reconstruct", "instok3d.model.files"):
        monkeypatch.setattr(f"{module}.DEFAULT_MODEL", model)
    monkeypatch.setattr("instok3d.scene.demo.demo_photos", lambda: nullcontext(photos))
    monkeypatch.chdir(tmp_path)
    said = []
    for name in ("01_render.py", "00_reconstruct.py", "02_export.py"):
        run(monkeypatch, name)
        said.append("demo.itk is not there: making it" in capsys.readouterr().out)
    assert said == [True, False, False]
    assert (tmp_path / "demo.itk/previews/contact_sheet.png").is_file()
    assert (tmp_path / "between.png").is_file()
    assert (tmp_path / "objects").is_dir()
