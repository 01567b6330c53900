"""benchmarks/gpu.py at toy sizes on the CPU: its parts, what one failure leaves, the table."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
TOY = ["--device", "cpu", "--toy"]


def gpu(out: Path, *words: str, folder: Path = FOLDER) -> tuple[int, str, list[dict]]:
    """Exit code, table, and the parts of gpu.json."""
    command = [sys.executable, str(folder / "gpu.py"), "--out", str(out), *TOY, *words]
    done = subprocess.run(command, capture_output=True, text=True)
    return done.returncode, done.stdout, json.loads((out / "gpu.json").read_text())["parts"]


def copy_with_parts(folder: Path, parts: str) -> Path:
    """The same program with other parts in the place of its own."""
    (folder / "gpu_parts").mkdir(parents=True)
    (folder / "gpu.py").write_text((FOLDER / "gpu.py").read_text())
    (folder / "gpu_parts" / "rows.py").write_text((FOLDER / "gpu_parts" / "rows.py").read_text())
    head = (
        "import atexit, os, signal, time\nfrom gpu_parts.rows import Row, at_most\nBUILD = 'none'\n"
    )
    (folder / "gpu_parts" / "__init__.py").write_text(head + parts)
    return folder


FAILING = """
def fails(setting):
    print("what it prints is no part of the table")
    raise ValueError("no | kernel")
def dies(setting):
    os.kill(os.getpid(), signal.SIGKILL)
def breaks(setting):
    atexit.register(os._exit, 3)
    return [Row("answer", "41")]
def hangs(setting):
    print("in the kernel", flush=True)
    time.sleep(600)
def wrong(setting):
    return [at_most("error", float("nan"), 1.0)]
def works(setting):
    return [Row("answer", "42", "42", True)]
PARTS = {each.__name__: each for each in (fails, dies, breaks, wrong, works, hangs)}
"""


def test_one_failure_does_not_end_the_others(tmp_path: Path):
    folder = copy_with_parts(tmp_path / "copy", FAILING)
    names = ["fails", "dies", "breaks", "wrong", "works"]
    code, table, parts = gpu(tmp_path / "out", "--only", *names, folder=folder)
    assert code == 1
    assert [part["part"] for part in parts] == names
    assert [part["good"] for part in parts] == [False, False, False, False, True]
    assert parts[0]["error"].endswith("ValueError: no | kernel")
    assert parts[1]["error"] == "exit code -9"
    assert parts[2]["error"] == "exit code 3"
    assert table.startswith("| part | what | measured | expected | verdict |\n")
    assert "| breaks | answer | 41 |  |  |" in table
    assert "| wrong | error | nan | <= 1 | BAD |" in table
    assert "| works | answer | 42 | 42 | good |" in table
    assert table.rstrip().endswith("1 of 5 parts good; look at fails, dies, breaks, wrong")
    lines = [line for line in table.splitlines() if line.startswith("|")]
    assert len(lines) == 2 + 6
    assert {line.count("|") for line in lines} == {6}


@pytest.mark.parametrize("minutes", [("--minutes-per-part", "0.02"), ("--minutes", "0.02")])
def test_a_part_that_hangs_is_stopped(tmp_path: Path, minutes: tuple[str, str]):
    folder = copy_with_parts(tmp_path / "copy", FAILING)
    names = ["hangs", "works"]
    code, _, parts = gpu(tmp_path / "out", "--only", *names, *minutes, folder=folder)
    assert code == 1
    assert parts[0]["error"].startswith("stopped after 1 s")
    if minutes[0] == "--minutes":
        assert parts[1]["error"] == "not started: no time is left; raise --minutes"


def test_a_part_that_is_not_there_is_named_and_nothing_written(tmp_path: Path):
    out = tmp_path / "out"
    command = [sys.executable, str(FOLDER / "gpu.py"), "--out", str(out), "--only", "speed"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert "no part ['speed']; there are machine, gsplat, rasterizer" in done.stderr
    assert not out.exists()


def test_a_real_part_runs_and_the_json_holds_the_rows_of_the_table(tmp_path: Path):
    code, table, parts = gpu(tmp_path, "--only", "rasterizer")
    assert code == 0, table
    (part,) = parts
    assert (part["part"], part["error"], part["good"]) == ("rasterizer", None, True)
    assert len(part["rows"]) == 6
    for row in part["rows"]:
        assert f"| {row['what']} | {row['measured']} | {row['expected']} | good |" in table


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_without_a_gpu_a_part_says_so(tmp_path: Path):
    code, _, parts = gpu(tmp_path, "--only", "machine", "--device", "cuda")
    assert code == 1
    assert "--device cuda: torch sees no CUDA device here" in parts[0]["error"].splitlines()[-1]


ONE_OF_EACH_KIND = ["reconstruct", "forward-2view", "train-scannet-2view", "fsdp-1process"]
"""The others run the same code with other numbers, and all of them at once take a minute."""


@pytest.mark.slow
def test_one_part_of_each_kind_is_good_at_toy_sizes_on_the_cpu(tmp_path: Path):
    code, table, parts = gpu(tmp_path, "--only", *ONE_OF_EACH_KIND)
    assert [part["error"] for part in parts if part["error"]] == []
    assert code == 0, table
    assert [part["part"] for part in parts] == ONE_OF_EACH_KIND
    assert all(part["rows"] for part in parts)
