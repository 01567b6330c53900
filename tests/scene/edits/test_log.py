"""The log of edits in a scene folder: exact, crash-safe, refused where it is damaged."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from edited_scenes import assert_bit_equal
from instok3d.files import sha256_of
from instok3d.scene.edits.folder import editing, keep_log
from instok3d.scene.edits.history import History
from instok3d.scene.edits.log import write_log
from instok3d.scene.edits.operations import Insert
from instok3d.scene.edits.ownership import part_of
from instok3d.scene.files import read_digest
from instok3d.scene.previews import save_with_previews
from instok3d.scene.scene import Scene
from kill_points import every_kill


def edit_in_place(path: Path, change: Callable[[Scene], Scene]) -> Scene:
    with editing(path):
        edited = change(Scene.load(path))
        assert edited.history is not None
        keep_log(path, edited.history)
    return edited


def many_edits(scene: Scene) -> Scene:
    """One of each kind, apart from two."""
    moved = scene.move(1, (0.1, 0.2, 0), yaw=20).recolor(3, "teal").rename(3, "ball").hide(3)
    more = moved.insert(scene, "object#1", (0, 0.3, 2)).duplicate(5, (0.2, 0, 0)).show(3)
    return more.split(5, box=((-9, -9, -9), (0, 9, 9))).merge(6, 7).remove(1)


@pytest.fixture
def path(tmp_path: Path, scene: Scene) -> Path:
    scene.save(tmp_path / "room.itk")
    return tmp_path / "room.itk"


def test_what_was_edited_is_loaded_and_can_be_undone_and_redone(path: Path, scene: Scene):
    source = {file: sha256_of(file) for file in path.rglob("*") if file.is_file()}
    edited = edit_in_place(path, many_edits)
    loaded = instok3d.load(path)
    assert_bit_equal(loaded, edited)
    assert_bit_equal(Scene.load(path, edits=False), scene)
    for file, digest in source.items():
        assert file.name == "scene.json" or sha256_of(file) == digest, file
    header = json.loads((path / "scene.json").read_text())
    assert header["edited"] == 10 == len(edited.edits)
    for number in range(10, 0, -1):
        back = edit_in_place(path, lambda scene: scene.undo())
        assert len(back.edits) == number - 1
    assert_bit_equal(instok3d.load(path), scene)
    assert json.loads((path / "scene.json").read_text())["edited"] == 0
    for _ in range(10):
        edit_in_place(path, lambda scene: scene.redo())
    assert_bit_equal(instok3d.load(path), edited)


def test_a_saved_edited_scene_keeps_source_and_log(tmp_path: Path, scene: Scene):
    edited = many_edits(scene)
    save_with_previews(edited, tmp_path / "a.itk")
    loaded = instok3d.load(tmp_path / "a.itk")
    assert_bit_equal(loaded, edited)
    loaded.undo().save(tmp_path / "a.itk", overwrite=True)
    again = instok3d.load(tmp_path / "a.itk")
    assert_bit_equal(again.redo(), edited)
    assert_bit_equal(Scene.load(tmp_path / "a.itk", edits=False), scene)


def test_a_log_is_replayed_on_another_copy(path: Path, tmp_path: Path):
    shutil.copytree(path, tmp_path / "copy.itk")
    edited = edit_in_place(path, many_edits)
    shutil.copy(path / "edits.jsonl", tmp_path / "copy.itk")
    shutil.copytree(path / "edits", tmp_path / "copy.itk/edits")
    assert_bit_equal(instok3d.load(tmp_path / "copy.itk"), edited)


def test_files_that_no_edit_needs_any_more_go(path: Path):
    edit_in_place(path, lambda scene: scene.insert(scene, 1, (0, 0, 1)))
    assert len(list((path / "edits").iterdir())) == 1
    edit_in_place(path, lambda scene: scene.undo())
    assert len(list((path / "edits").iterdir())) == 1  # it can be redone
    edit_in_place(path, lambda scene: scene.hide(1))
    assert list((path / "edits").iterdir()) == []


def test_an_old_scene_folder_is_edited_in_place(tmp_path: Path):
    golden = Path(__file__).resolve().parents[2] / "golden"
    for version in (1, 2, 3):
        path = tmp_path / f"v{version}.itk"
        shutil.copytree(golden / f"scene_v{version}", path)
        before = instok3d.load(path)
        edited = edit_in_place(path, lambda scene: scene.remove(1))
        assert_bit_equal(instok3d.load(path), edited)
        assert_bit_equal(instok3d.load(path).undo(), before)


def test_killed_at_any_operation_the_log_is_whole_or_the_old_one(tmp_path: Path, scene: Scene):
    scene.save(tmp_path / "before.itk")
    once = edit_in_place(tmp_path / "before.itk", lambda scene: scene.hide(3))
    twice = once.insert(scene, 1, (0, 0, 1)).history
    assert twice is not None

    def prepare() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        shutil.copytree(tmp_path / "before.itk", tmp_path / "work" / "room.itk")
        return tmp_path / "work"

    def insert(folder: Path) -> None:
        with editing(folder / "room.itk"):
            keep_log(folder / "room.itk", twice)

    found = set()
    for folder in every_kill(prepare, insert, step=3):
        loaded = instok3d.load(folder / "room.itk")
        found.add(len(loaded.edits))
        if len(loaded.edits) == 1:
            insert(folder)
        names = sorted(each.name for each in (folder / "room.itk").iterdir())
        assert names == sorted([
            "cameras.json", "edits", "edits.jsonl", "gaussians.safetensors", "inputs",
            "objects.json", "scene.json", "semantics", "tokens.safetensors",
        ]) or len(loaded.edits) == 2  # fmt: skip
        assert len(instok3d.load(folder / "room.itk").edits) == 2
    assert found == {1, 2}


def test_of_two_who_edit_one_scene_the_second_is_refused(path: Path):
    with editing(path), pytest.raises(ValueError, match="another run is editing"):
        edit_in_place(path, lambda scene: scene.remove(1))
    with pytest.raises(FileNotFoundError, match="is not a scene folder"):
        edit_in_place(path / "nowhere", lambda scene: scene)


def lines_changed(change: Callable[[list[dict]], object]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        rows = [json.loads(line) for line in (path / "edits.jsonl").read_text().splitlines()]
        change(rows)
        (path / "edits.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))

    return apply


def cut_in_half(path: Path) -> None:
    content = (path / "edits.jsonl").read_bytes()
    (path / "edits.jsonl").write_bytes(content[: len(content) // 2])


def flip_a_byte_of_a_part(path: Path) -> None:
    file = max((path / "edits").iterdir(), key=lambda file: file.stat().st_size)
    content = bytearray(file.read_bytes())
    content[-3] ^= 1
    file.write_bytes(bytes(content))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "edits.jsonl is missing, by scene.json it has 10": lambda p: (p / "edits.jsonl").unlink(),
    r"line 1 is damaged": lambda p: (p / "edits.jsonl").write_bytes(b"\xff\n"),
    r"it has 0 lines": lambda p: (p / "edits.jsonl").write_bytes(b""),
    r"edits\.jsonl.* is damaged": cut_in_half,
    "its first line says 11": lines_changed(lambda rows: rows[0].update(done=11)),
    "says 9": lambda p: (lines_changed(lambda rows: rows[0].update(done=9))(p),
                         lines_changed(lambda rows: rows.__delitem__(slice(9, None)))(p)),
    "reads logs of version 3, not 4; use a newer": lines_changed(
        lambda rows: rows[0].update(version=4)
    ),
    "its format is 'other'": lines_changed(lambda rows: rows[0].update(format="other")),
    "belongs to another scene": lines_changed(lambda rows: rows[0].update(source="0" * 64)),
    r"line 2: there is no operation 'explode'": lines_changed(
        lambda rows: rows[1].update(edit="explode")
    ),
    r"line 2 is damaged .unknown keys \['speed'\]": lines_changed(
        lambda rows: rows[1].update(speed=3)
    ),
    r"line 2 is damaged .it lacks 'motion'": lines_changed(lambda rows: rows[1].pop("motion")),
    "is no quaternion of unit length": lines_changed(
        lambda rows: rows[1]["motion"].update(quat_wxyz=[0, 0, 0, 0])
    ),
    "scale must be a number above 0": lines_changed(
        lambda rows: rows[1]["motion"].update(scale=0)
    ),
    r"edit 1 \(move\) cannot be done: the object, moved like this, has": lines_changed(
        lambda rows: rows[1]["motion"].update(translation=[1e30, 0, 0])
    ),
    r"edit 1 \(move\) cannot be done: no object 9": lines_changed(
        lambda rows: rows[1].update(object=9)
    ),
    "'1' is no whole number": lines_changed(lambda rows: rows[1].update(object="1")),
    "is no list of different ids": lines_changed(lambda rows: rows[-1].update(objects=[1, 1])),
    "no name of a file of an edit": lines_changed(
        lambda rows: rows[5].update(part="../gaussians.safetensors")
    ),
    r"the scene is incomplete: .*0000\.safetensors is missing": lines_changed(
        lambda rows: rows[5].update(part="0" * 64 + ".safetensors")
    ),
    "is not the file that the edit was written for": flip_a_byte_of_a_part,
    r"holds \['rows'\], wanted": lines_changed(
        lambda rows: rows[5].update(part=rows[8]["rows"])
    ),
    r"edit 4 \(hide\) cannot be done": lines_changed(lambda rows: rows[4].update(objects=[2])),
    r"label '#' must|could be taken": lines_changed(lambda rows: rows[3].update(label="#")),
}  # fmt: skip


@pytest.mark.parametrize("sentence", DAMAGE)
def test_a_damaged_log_is_refused_and_the_source_still_read(
    sentence: str, path: Path, scene: Scene
):
    edit_in_place(path, many_edits)
    DAMAGE[sentence](path)
    with pytest.raises((ValueError, FileNotFoundError), match=sentence):
        instok3d.load(path)
    assert_bit_equal(Scene.load(path, edits=False), scene)


def test_a_part_that_cannot_be_drawn_is_refused(path: Path, scene: Scene):

    part = part_of(scene, scene.object(1))
    broken = replace(
        part, gaussians=replace(part.gaussians, opacities=part.gaussians.opacities + 1)
    )
    history = History.begin(scene, read_digest(path)[0])
    for bad in (broken, replace(part, positions=part.positions * torch.nan)):
        write_log(path, replace(history, edits=(Insert(bad, None, 1.0, "x"),)))
        with pytest.raises(ValueError, match=r"line 2 is damaged"):
            instok3d.load(path)
