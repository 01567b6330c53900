"""The tests that need a GPU."""

import re
import subprocess
import sys
from pathlib import Path

from gpu_parts.rows import Row, Setting

ROOT = Path(__file__).resolve().parents[2]


def run_marked_tests(setting: Setting) -> list[Row]:
    """Pytest -m gpu: on a GPU all must pass and none may be skipped; elsewhere all are skipped."""
    # Only files that have such tests: others may import what a machine without network lacks.
    files = sorted(path for path in ROOT.glob("tests/**/test_*.py") if _is_marked(path))
    # One process, since there is one GPU; and the machine may lack what runs several.
    command = [sys.executable, "-m", "pytest", "-q", "-m", "gpu", "-p", "no:cacheprovider"]
    command += ["-o", "addopts=--strict-markers --import-mode=importlib"]
    done = subprocess.run(
        [*command, *map(str, files)], cwd=ROOT, capture_output=True, text=True, errors="replace"
    )
    lines = done.stdout.strip().splitlines() or [done.stderr[-300:]]
    outcomes = set(re.findall(r"\d+ (passed|failed|skipped|error)", lines[-1]))
    wanted = "passed" if setting.on_gpu else "skipped"
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return [
        Row("pytest -m gpu", lines[-1], f"{wanted} alone", outcomes == {wanted}),
        *(Row(line.split(" ", 1)[1][:120], "failed", "passed", False) for line in failed),
    ]


def _is_marked(file: Path) -> bool:
    return "@pytest.mark.gpu" in file.read_text(encoding="utf-8")
