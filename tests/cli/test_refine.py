import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from instok3d.cli import main
from instok3d.cli.signals import EndedBySignal, asked_to_stop, orderly_end
from instok3d.pictures import color_picture
from made_scene import made_scene, made_tokens


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    scene = made_scene(made_tokens())
    photos = torch.from_numpy(color_picture(scene.render().colors))
    pale = replace(scene.gaussians, sh=0.5 * scene.gaussians.sh)
    replace(scene, photos=photos, gaussians=pale).save(tmp_path / "pale.itk")
    return tmp_path


def test_a_scene_is_refined_into_another(folder: Path, capsys: pytest.CaptureFixture[str]):
    source, target = folder / "pale.itk", folder / "sharp.itk"
    before = (source / "scene.json").read_bytes()
    assert main(["refine", str(source), "-o", str(target), "--steps", "12", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    (record,) = shown["provenance"]["refinements"]
    assert record["steps"] == 12
    assert record["psnr_after"] > record["psnr_before"]
    assert shown["tokens_give_gaussians"] is False
    assert (source / "scene.json").read_bytes() == before
    assert (target / "previews" / "contact_sheet.png").is_file()
    assert main(["info", str(target)]) == 0
    assert "refined, 12 steps on the photos at 24 x 32: " in capsys.readouterr().out


def test_bad_input_is_one_line_and_leaves_nothing(folder: Path, capsys: pytest.CaptureFixture[str]):
    scene = str(folder / "pale.itk")
    for words, named in (
        (["-o", scene], "already there"),
        (["-o", str(folder / "new.itk"), "--steps", "-3"], "steps of refinement"),
        (["-o", str(folder / "new.itk"), "--pixels", "512"], "give the photos"),
        (["-o", str(folder / "new.itk"), "--densify", "2"], "split_share"),
        (["-o", str(folder / "new.itk"), "--photos", str(folder)], "no photo"),
    ):
        assert main(["refine", scene, *words]) == 2, words
        error = capsys.readouterr().err.strip().splitlines()[-1]
        assert named in error
    assert not (folder / "new.itk").exists()


def test_the_first_ctrl_c_is_a_request_and_the_second_ends():
    with orderly_end(), asked_to_stop(when=True) as stop:
        assert stop is not None
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        with pytest.raises(EndedBySignal):
            os.kill(os.getpid(), signal.SIGINT)
    with asked_to_stop(when=False) as stop:
        assert stop is None


def test_other_threads_are_never_asked():
    answers = []

    def ask() -> None:
        with asked_to_stop(when=True) as stop:
            answers.append(stop)

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    assert answers == [None]


def test_ctrl_c_keeps_what_was_reached_when_asked_to(folder: Path):
    """In a process of its own, interrupted at its first report of progress."""
    code = """
import os, signal, sys
from instok3d.cli import main
from instok3d.refinement import optimization
def interrupted(squared_error, seen=[]):
    if not seen: os.kill(os.getpid(), signal.SIGINT)
    seen.append(0)
    return original(squared_error)
original = optimization._decibels
optimization._decibels = interrupted
sys.exit(main(sys.argv[1:]))
"""
    target = folder / "kept.itk"
    words = ["refine", str(folder / "pale.itk"), "-o", str(target), "--steps", "5000"]
    done = subprocess.run(
        [sys.executable, "-c", code, *words, "--keep-interrupted"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "ended after" in done.stderr
    assert not instok3d.load(target).provenance.refinements
    ended = subprocess.run(
        [sys.executable, "-c", code, *words, "--overwrite"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert ended.returncode == 130
    assert target.is_dir()
