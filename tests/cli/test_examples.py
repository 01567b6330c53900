"""The examples run: of the demo without arguments, and of the scenes that they are given."""

import re
import runpy
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import instok3d
from instok3d.formats.ply import read_ply
from made_model import made_model, made_photos
from made_scene import HEIGHT, made_scene, made_tokens
from shipped_demo import ShippedDemo

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
Run = Callable[..., list[str]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs an example in an empty folder and returns the lines that it printed."""
    monkeypatch.chdir(tmp_path)

    def run_example(name: str, *arguments: str | Path) -> list[str]:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run_example


@pytest.fixture
def room(tmp_path: Path) -> str:
    """A scene folder: object#1 and object#3, and some that belong to none."""
    made_scene(made_tokens()).save(tmp_path / "room.itk")
    return "room.itk"


@pytest.fixture
def small_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = made_model(tmp_path / "model.safetensors")
    for module in ("instok3d.scene.reconstruct", "instok3d.model.files"):
        monkeypatch.setattr(f"{module}.DEFAULT_MODEL", model)
    monkeypatch.setattr("instok3d.scene.lifting.SHIPPED", tmp_path / "none")  # of another model


def pixels(path: str, across: int = 1) -> list[np.ndarray]:
    """The cells of a picture that has `across` of them in each row, of the scene's size."""
    picture = np.asarray(Image.open(path))
    height, width = HEIGHT, picture.shape[1] // across
    assert picture.shape[0] % height == 0
    return [
        picture[top : top + height, left : left + width]
        for top in range(0, picture.shape[0], height)
        for left in range(0, picture.shape[1], width)
    ]


def test_examples_are_numbered_and_say_how_they_are_called():
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    assert [name[:3] for name in names] == [f"{number:02d}_" for number in range(len(names))]
    for name in names:
        page = (EXAMPLES / f"{name}.py").read_text()
        assert f"\n\npython examples/{name}.py " in page.split('"""')[1]


@pytest.mark.usefixtures("small_model")
def test_reconstruct(tmp_path: Path, run: Run):
    with pytest.warns(UserWarning, match="trained on rendered rooms alone"):
        run("00_reconstruct", made_photos(tmp_path / "in"), "a.itk")
    assert Path("a.itk/scene.json").is_file()


@pytest.mark.usefixtures("small_model")
@pytest.mark.filterwarnings("ignore:.*trained on rendered rooms alone")
def test_without_arguments_they_make_the_scene_of_the_demo_once_and_say_so(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
):
    photos = made_photos(tmp_path / "in")
    monkeypatch.setattr("instok3d.scene.demo.demo_photos", lambda: nullcontext(photos))
    said = [
        any("demo.itk is not there: making it" in line for line in run(name))
        for name in ("01_look", "00_reconstruct", "06_export")
    ]
    assert said == [True, False, False]
    assert Path("demo.itk/previews/contact_sheet.png").is_file()


def test_look(room: str, run: Run):
    printed = run("01_look", room, "look.png")
    assert [line.split(":")[0] for line in printed] == ["object#1", "object#3"]
    assert all(panel.any() for panel in pixels("look.png", across=3))


def test_isolated_object_is_all_that_is_left(room: str, run: Run):
    assert run("02_isolate", room, 3, "alone.itk") == ["object#3: 8 of 40 Gaussians, in alone.itk"]
    alone = instok3d.load("alone.itk")
    assert [item.key for item in alone.objects] == ["object#3"]
    assert len(alone.gaussians.means) == 8
    assert all(picture[0, 0].tolist() == [255, 255, 255] for picture in pixels("alone.png", 2))


def test_removed_object_is_gone_and_nothing_else_changed(room: str, run: Run):
    printed = run("03_remove", room, "object#3", "removed.itk")
    assert printed[0].startswith("object#3 removed: ")
    assert printed[1].endswith(" pixels outside of it: 0.0")
    assert [item.id for item in instok3d.load("removed.itk").objects] == [1]
    before, _, after, _, _, _ = pixels("removed.png", across=2)
    assert (before != after).any()


def test_moved_object_is_elsewhere_and_its_name_was_undone(room: str, run: Run):
    (printed,) = run("04_move", room, 1, "moved.itk")
    assert printed.startswith(
        "move object#1 by (0.15, 0.05, -0.15), turned by 15 degrees about (0, 1, 0)"
    )
    assert instok3d.load("moved.itk").object(1).label is None
    before, _, after, _ = pixels("moved.png", across=2)
    assert (before != after).any()


def test_inserted_object_stands_in_the_other_room(room: str, run: Run):
    (printed,) = run("05_insert", room, 1, room, 3, "inserted.itk")
    assert printed.startswith("object#5 stands on object#1, seen in ")
    assert len(instok3d.load("inserted.itk").gaussians.means) == 48


def test_exported_files_are_there_and_hold_the_objects(room: str, run: Run):
    printed = run("06_export", room, "files")
    names = ["hulls.glb", "room.glb", "room.html", "room.ply", "room.spz", "room.spz.json"]
    assert [line.split(":")[0] for line in printed] == [
        *[str(Path("files", name)) for name in names], str(Path("files", "objects")),
    ]  # fmt: skip
    assert len(read_ply(Path("files/objects/003.ply")).gaussians.means) == 8


def test_imported_file_is_a_scene_with_its_groups(room: str, run: Run):
    run("06_export", room, "files")
    printed = run("07_import", "files/room.glb", "imported.itk")
    assert printed == ["object#1: 12 Gaussians", "object#3: 8 Gaussians"]
    assert len(instok3d.load("imported.itk").objects) == 2
    assert Path("imported.png").is_file()


def test_without_a_file_to_import_the_example_says_how_it_is_called(run: Run):
    with pytest.raises(SystemExit, match=r"python examples/07_import.py FILE imported.itk"):
        run("07_import")


def test_the_authors_scene_is_imported_with_its_eleven_groups(shared: Path, run: Run):
    folder = shared / "data/instok3d_authors/demo/scene0694_01/splat"
    assert len(run("07_import", folder, "authors.itk")) == 11


@pytest.mark.parametrize(
    ("name", "output"),
    [("02_isolate", "alone"), ("04_move", "moved")],
)
def test_without_arguments_they_pick_the_chair_of_the_demo(
    shipped_demo: ShippedDemo, run: Run, name: str, output: str
):
    Path("demo.itk").symlink_to(shipped_demo.scene)
    chair = instok3d.load("demo.itk").object(6)  # as the README calls it
    printed = run(name)
    assert any(chair.key in line for line in printed)
    assert Path(f"{output}.png").is_file()
    assert Path(f"{output}.itk/scene.json").is_file()


def test_the_hole_of_the_demos_chair_is_drawn_in_each_photo(shipped_demo: ShippedDemo, run: Run):
    Path("demo.itk").symlink_to(shipped_demo.scene)
    run("03_remove")
    picture = np.asarray(Image.open("removed.png"))
    before, after, hole = picture.reshape(3, 128, 8, 128, 3).transpose(0, 2, 1, 3, 4)
    assert (hole.max(axis=(1, 2, 3)) == 255).all()
    assert (before[hole > 0] != after[hole > 0]).mean() > 0.9


@pytest.mark.usefixtures("small_model")
@pytest.mark.filterwarnings("ignore:.*trained on rendered rooms alone")
def test_without_arguments_another_room_is_made_to_take_an_object_from(
    shipped_demo: ShippedDemo, run: Run
):
    pytest.importorskip("embreex")
    Path("demo.itk").symlink_to(shipped_demo.scene)
    printed = run("05_insert")
    assert printed[0] == "other.itk is not there: making it, in a minute"
    assert re.search(r" stands on floor#\d+, seen in ", printed[1])
    assert Path("inserted.png").is_file()
