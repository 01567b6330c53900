import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from instok3d.batch import scenes
from instok3d.batch.pool import Processes
from instok3d.batch.run import run_batch
from instok3d.batch.scenes import Options, find_scenes
from instok3d.cli import main
from instok3d.library.folder import FolderLibrary
from instok3d.locking import alone_in
from instok3d.scene.reconstruct import reconstruct
from instok3d.scene.scene import Scene
from made_model import made_model, made_photos
from made_scene import made_scene, made_tokens


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    made_photos(folder / "kitchen")
    made_photos(folder / "bath", 3)
    (folder / "broken").mkdir()
    (folder / "broken" / "a.png").write_text("no picture")
    (folder / ".hidden").mkdir()
    return folder


@pytest.fixture
def options(tmp_path: Path) -> Options:
    return Options(model=made_model(tmp_path / "model.safetensors"), refine=0)


def quiet(line: str) -> None:
    """Takes what went wrong."""


def test_every_scene_is_what_reconstruct_makes_and_a_bad_one_ends_nothing(
    photos: Path, options: Options, tmp_path: Path
):
    said: list[str] = []
    options = replace(options, pixels=64)
    batch = run_batch(photos, tmp_path / "out", options, say=said.append)
    assert sorted(batch.results) == ["bath", "broken", "kitchen"]
    assert [*batch.failed] == ["broken"]
    assert len(said) == 1
    assert said[0].startswith("broken: ")
    assert "a.png" in said[0]
    alone = reconstruct(photos / "kitchen", model=options.model, refine=0, pixels=64)
    made = Scene.load(tmp_path / "out" / "kitchen.itk")
    assert made.provenance == alone.provenance
    assert (made.height, made.width) == (64, 64)
    assert made.gaussians.means.equal(alone.gaussians.means)
    record = json.loads((tmp_path / "out" / "batch.json").read_text())
    assert (record["done"], record["failed"]) == (2, 1)
    assert record["scenes"]["kitchen"]["objects"] == len(alone.objects)
    with Image.open(tmp_path / "out" / "contact_sheet.jpg") as sheet:
        assert sheet.width > 2 * 320
    assert {each.name for each in (tmp_path / "out").iterdir()} == {
        "bath.itk", "kitchen.itk", "batch.json", "contact_sheet.jpg",
    }  # fmt: skip


def test_the_model_is_read_once(photos: Path, options: Options, tmp_path: Path):
    scenes.held_model.cache_clear()
    run_batch(photos, tmp_path / "out", options, say=quiet)
    about = scenes.held_model.cache_info()
    assert (about.misses, about.hits) == (1, 1)


@pytest.mark.slow
def test_two_processes_make_the_scenes_that_one_makes(
    photos: Path, options: Options, tmp_path: Path
):
    (photos / "broken" / "a.png").unlink()
    (photos / "broken").rmdir()
    batch = run_batch(photos, tmp_path / "out", options, executor=Processes(2), say=quiet)
    assert (batch.made, batch.failed) == (2, {})
    for name in ("bath", "kitchen"):
        scene = Scene.load(tmp_path / "out" / f"{name}.itk")
        alone = reconstruct(photos / name, model=options.model, refine=0)
        assert len(scene.objects) == len(alone.objects) == batch.results[name].objects
        assert scene.provenance == alone.provenance


def test_run_again_it_makes_what_failed_or_was_changed_alone(
    photos: Path, options: Options, tmp_path: Path
):
    run_batch(photos, tmp_path / "out", options, say=quiet)
    before = (tmp_path / "out" / "bath.itk").stat().st_ino
    batch = run_batch(photos, tmp_path / "out", options, say=quiet)
    assert batch.made == 1  # the broken one, in vain
    (photos / "broken" / "a.png").unlink()
    for path in (photos / "kitchen").iterdir():
        (photos / "broken" / path.name).write_bytes(path.read_bytes())
    os.utime(photos / "kitchen" / "0.png", (1, 1))
    batch = run_batch(photos, tmp_path / "out", options, say=quiet)
    assert (batch.made, batch.failed) == (2, {})
    assert (tmp_path / "out" / "bath.itk").stat().st_ino == before


def test_other_options_need_another_folder(photos: Path, options: Options, tmp_path: Path):
    run_batch(photos, tmp_path / "out", options, say=quiet)
    with pytest.raises(ValueError, match=r"batch\.json is of scenes made with another seed: give"):
        run_batch(photos, tmp_path / "out", Options(options.model, refine=0, seed=1))


def test_two_runs_in_one_folder_are_refused(photos: Path, options: Options, tmp_path: Path):
    (tmp_path / "out").mkdir()
    with alone_in(tmp_path / "out" / "lock", "x"), pytest.raises(ValueError, match="another run"):
        run_batch(photos, tmp_path / "out", options)


def test_what_is_no_batch_is_refused(photos: Path, options: Options, tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        find_scenes(tmp_path / "nowhere")
    with pytest.raises(
        ValueError, match=r"no subfolder with photos.*one scene, which `reconstruct"
    ):
        find_scenes(photos / "kitchen")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"has no subfolder with photos and no video$"):
        find_scenes(tmp_path / "empty")
    with pytest.raises(FileNotFoundError, match="there is no model"):
        run_batch(photos, tmp_path / "out", Options(model=tmp_path / "none.safetensors"))
    with pytest.raises(ValueError, match="workers must be 1 or more, got 0"):
        Processes(0)
    (photos / "bath.mp4").touch()
    with pytest.raises(ValueError, match=r"would both become bath\.itk"):
        find_scenes(photos)
    assert not (tmp_path / "out").exists()


def test_scenes_go_into_a_library_those_of_earlier_runs_too(
    photos: Path, options: Options, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):  # fmt: skip
    # The tiny model has no semantics: scenes made by hand stand in for its own.
    monkeypatch.setattr(
        "instok3d.scene.reconstruct.reconstruct", lambda *_, **__: made_scene(made_tokens())
    )
    arguments = ["batch", str(photos), "-o", str(tmp_path / "out"), "--model", str(options.model)]
    assert main([*arguments, "--refine", "0"]) == 0
    library = str(tmp_path / "lib")
    assert main([*arguments, "--refine", "0", "--library", library]) == 0
    assert [each.objects for each in FolderLibrary(Path(library)).scenes()] == [2, 2, 2]
    assert "3 scenes, 0 failed, 0 tried in this run" in capsys.readouterr().out


def test_a_scene_without_semantics_is_made_and_said_not_to_be_in_the_library(
    photos: Path, options: Options, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = ["--model", str(options.model), "--refine", "0", "--json"]
    output, library = str(tmp_path / "out"), str(tmp_path / "lib")
    assert main(["batch", str(photos), "-o", output, "--library", library, *arguments]) == 2
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert (found["done"], found["failed"]) == (2, 1)
    assert found["not_in_library"] == ["bath", "kitchen"]
    assert "kitchen: made, but" in said.err
    assert "has no semantics" in said.err
    assert not Path(library).exists()


def test_pixels_that_no_scene_can_have_are_refused_before_the_first_one(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["batch", str(photos), "-o", str(tmp_path / "out"), "--pixels", "5"]) == 2
    assert "pixels (--pixels) must lie in 64..512, got 5" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
