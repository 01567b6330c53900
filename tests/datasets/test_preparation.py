import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

import patience
from instok3d.datasets import preparation
from instok3d.datasets.preparation import (
    SPLIT_RULE,
    LeftOutError,
    estimate_bytes,
    plan_preparation,
    prepare,
)
from instok3d.datasets.prepared import PreparedScenes, read_index, verify
from kill_points import every_kill
from scene_jobs import frames_during_another_run, job, killing_frames, run, some_frames


def contents(folder: Path) -> dict[str, bytes]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_the_report_counts_what_came_and_the_index_lists_it(tmp_path: Path):
    report = run([job("a", some_frames, 3), job("b", some_frames, 2)], tmp_path / "out")
    assert (report.scenes, report.frames, report.skipped) == (2, 5, 0)
    assert report.dropped == {"no pose": 2}
    index = read_index(tmp_path / "out")
    assert {name: scene["num_frames"] for name, scene in index.items()} == {"a": 3, "b": 2}
    assert report.num_bytes == sum(scene["bytes"] for scene in index.values())


def test_a_second_run_makes_only_what_is_missing(tmp_path: Path):
    run([job("a"), job("b")], tmp_path)
    before = (tmp_path / "a" / "scene.json").stat().st_mtime_ns
    plan = plan_preparation([job("a"), job("b"), job("c")], tmp_path)
    assert [each.info.name for each in plan.jobs] == ["c"]
    report = prepare(plan, workers=1, progress=False)
    assert (report.scenes, report.skipped) == (1, 2)
    assert (tmp_path / "a" / "scene.json").stat().st_mtime_ns == before
    assert list(verify(tmp_path)) == []


def test_several_processes_make_the_same_bytes(tmp_path: Path):
    jobs = [job(name, some_frames, count) for name, count in (("a", 2), ("b", 3), ("c", 1))]
    jobs.append(job("d", some_frames, 1, ValueError("cut off")))
    alone, together = tmp_path / "alone", tmp_path / "together"
    reports = [run(jobs, alone), run(jobs, together, workers=2)]
    assert reports[0] == reports[1]
    assert reports[0].failed == {"d": "cut off"}
    files = [sorted(p.relative_to(f) for p in f.rglob("*")) for f in (alone, together)]
    assert files[0] == files[1]
    for name in files[0]:
        if (alone / name).is_file():
            assert (alone / name).read_bytes() == (together / name).read_bytes()


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (ValueError("the  file\nis cut off"), "the file is cut off"),
        (KeyError("no such member"), "no such member"),
        (FileNotFoundError("there is no file x"), "there is no file x"),
    ],
)
def test_a_scene_that_fails_is_reported_and_the_others_go_on(
    tmp_path: Path, fault: Exception, reason: str
):
    report = run([job("a", some_frames, 2, fault), job("b")], tmp_path)
    assert report.failed == {"a": reason}
    assert report.scenes == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b", "scenes.json"]
    assert run([job("a"), job("b")], tmp_path).scenes == 1  # and can be made later


def test_scenes_that_are_not_wanted_are_no_failures(tmp_path: Path):
    jobs = [job("a", some_frames, 2, LeftOutError("pictures of 10 x 10")), job("b")]
    report = run(jobs, tmp_path)
    assert (report.left_out, report.failed) == ({"pictures of 10 x 10": 1}, {})


def test_what_does_not_fit_on_the_disk_is_refused_before_anything_is_written(tmp_path: Path):
    plan = plan_preparation([replace(job("a"), estimated_bytes=2**60)], tmp_path / "out")
    with pytest.raises(OSError, match=r"take about .* GB, only .* GB are free") as error:
        prepare(plan, progress=False)
    assert error.value.errno == errno.ENOSPC
    assert not (tmp_path / "out").exists()


def test_a_disk_that_becomes_full_stops_everything(tmp_path: Path):
    jobs = [job("a", some_frames, 1, OSError(errno.ENOSPC, "full")), job("b")]
    with pytest.raises(OSError, match="full"):
        run(jobs, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scenes.json"]


def test_a_killed_worker_is_said_to_be_one(tmp_path: Path):
    with pytest.raises(MemoryError, match="fewer workers"):
        run([job("a", killing_frames, signal.SIGKILL), job("b")], tmp_path, workers=2)
    assert run([job("a"), job("b")], tmp_path).failed == {}
    assert list(verify(tmp_path)) == []


def started_program(tmp_path: Path) -> subprocess.Popen[bytes]:
    """A program that prepares scenes b and c in two processes, and has begun to."""
    tests = Path(__file__).resolve().parents[1]
    started, out = tmp_path / "started", tmp_path / "out"
    (tmp_path / "program.py").write_text(
        f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(tests)!r})
if __name__ == "__main__":
    from scene_jobs import job, run, slow_frames
    started = Path({str(started)!r})
    run([job("a"), job("b", slow_frames, started), job("c", slow_frames, started)],
        Path({str(out)!r}), workers=2)
"""
    )
    program = [sys.executable, str(tmp_path / "program.py")]
    process = subprocess.Popen(program, start_new_session=True, stderr=subprocess.PIPE)
    deadline = time.monotonic() + patience.SECONDS
    while not started.exists():
        if process.poll() is not None or time.monotonic() > deadline:
            process.kill()
            raise AssertionError(process.communicate()[1].decode())
        time.sleep(0.05)
    return process


def test_an_interrupt_leaves_whole_scenes_only(tmp_path: Path):
    """Ctrl-C as a terminal sends it: to the whole group of processes."""
    out = tmp_path / "out"
    run([job("a")], out)
    process = started_program(tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=patience.SECONDS)
    assert b"KeyboardInterrupt" in errors
    assert sorted(path.name for path in out.iterdir()) == ["a", "scenes.json"]
    assert list(verify(out)) == []


def test_a_killed_run_takes_its_workers_along_and_can_be_finished(tmp_path: Path):
    out = tmp_path / "out"
    run([job("a")], out)
    process = started_program(tmp_path)
    process.kill()
    process.communicate(timeout=patience.SECONDS)  # ends when no process holds its stderr any more
    left = [fault.path for fault in verify(out)]
    assert len(left) <= 2
    assert all(path.startswith(".instok3d-") and path.endswith(".part") for path in left)
    run([job("a"), job("b"), job("c")], out)
    assert list(verify(out)) == []


def test_killed_at_any_operation_it_leaves_whole_scenes_and_is_gone_on_with(tmp_path: Path):
    def prepare_two(folder: Path) -> None:
        run([job("a", some_frames, 1), job("b", some_frames, 1)], folder)

    def begun() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        return shutil.copytree(tmp_path / "begun", tmp_path / "work")

    prepare_two(tmp_path / "straight")
    whole = contents(tmp_path / "straight")
    run([job("a", some_frames, 1)], tmp_path / "begun")
    seen = set()
    for folder in every_kill(begun, prepare_two, step=5):
        scenes = PreparedScenes(folder)
        names = [scenes.name_of(number) for number in range(len(scenes))]
        seen.add(tuple(names))
        for number in range(len(scenes)):
            scenes.frames(number, range(scenes.num_frames(number)))
        prepare_two(folder)
        assert contents(folder) == whole
        assert list(verify(folder)) == []
    assert seen == {("a",), ("a", "b")}


def test_two_runs_do_not_prepare_into_one_folder(tmp_path: Path):
    report = run([job("a", frames_during_another_run, tmp_path)], tmp_path)
    assert "another run is preparing" in report.failed["a"]
    assert run([job("a"), job("z")], tmp_path).scenes == 2
    assert list(verify(tmp_path)) == []


def test_scenes_of_other_settings_are_not_mixed(tmp_path: Path):
    run([job("a", some_frames, 2, size=24)], tmp_path)
    with pytest.raises(ValueError, match=r"holds the scene a with settings\.size 24, not 48"):
        plan_preparation([job("a", some_frames, 2, size=48)], tmp_path)
    other_rule = job("a", some_frames, 2, size=24, **{SPLIT_RULE: "as published"})
    assert plan_preparation([other_rule], tmp_path).jobs == ()
    to_test = replace(other_rule, info=replace(other_rule.info, split="test"))
    with pytest.raises(ValueError, match="split 'train', not 'test'"):
        plan_preparation([to_test], tmp_path)


def test_what_cannot_be_planned_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="no scene to prepare"):
        plan_preparation([], tmp_path)
    with pytest.raises(ValueError, match="same name: a"):
        plan_preparation([job("a"), job("a")], tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(NotADirectoryError, match="it is a file"):
        plan_preparation([job("a")], tmp_path / "file")
    with pytest.raises(ValueError, match="workers must be 1 or more"):
        prepare(plan_preparation([job("a")], tmp_path), workers=0)


def test_a_disk_estimate_by_hand():
    # 2 frames of 10 x 20 pixels with 1.6 + 0.05 bytes each, 1,000 for the frame, 200 a picture.
    assert estimate_bytes(2, 10, 20, ("images", "labels")) == 2 * (330 + 1000 + 400)
    assert estimate_bytes(0, 10, 20, ("images",)) == 0
    assert set(preparation.BYTES_PER_PIXEL) == {"images", "depths", "instances", "labels"}
