"""The Dockerfiles: what they build from, copy, install and run. Nothing is built here."""

import fnmatch
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from command_lines import parses

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "docker").glob("*.Dockerfile"))
PAGE = (ROOT / "docs" / "containers.md").read_text()


def instructions(path: Path) -> list[tuple[str, str]]:
    """Name and rest of each, comments and breaks of lines taken out."""
    lines = [line for line in path.read_text().splitlines() if not line.lstrip().startswith("#")]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [(line.split()[0], line.split(maxsplit=1)[1]) for line in joined.splitlines() if line]


def last_stage(path: Path) -> list[tuple[str, str]]:
    found = instructions(path)
    start = max(index for index, (name, _) in enumerate(found) if name == "FROM")
    return found[start:]


def last(path: Path, name: str) -> str:
    return [rest for each, rest in last_stage(path) if each == name][-1]


def ignored(path: str) -> bool:
    """By .dockerignore: the last pattern that fits a path, or a folder above it, decides."""
    result = False
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        pattern = line.removeprefix("!").removeprefix("**/")
        parts = Path(path).parts
        above = ["/".join(parts[:count]) for count in range(1, len(parts) + 1)]
        names = parts if "**/" in line else above
        if line and not line.startswith("#") and any(fnmatch.fnmatch(n, pattern) for n in names):
            result = not line.startswith("!")
    return result


def test_there_is_one_for_the_processor_and_one_for_cuda():
    assert [path.name for path in FILES] == ["cpu.Dockerfile", "cuda.Dockerfile"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_the_linter_finds_nothing(path: Path):
    if shutil.which("hadolint") is None:
        pytest.skip("hadolint is not installed")
    command = ["hadolint", "--failure-threshold", "style", str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_bases_are_pinned_and_the_demo_is_run_by_a_user_without_rights(path: Path):
    bases = [rest.split()[0] for name, rest in instructions(path) if name == "FROM"]
    assert all(re.search(r":\d+\.\d+\.\d+-", base) for base in bases)
    user = last(path, "USER").split(":")[0]
    assert int(user) >= 1000
    made = [rest for name, rest in last_stage(path) if name == "RUN" and "useradd" in rest]
    assert len(made) == 1
    assert re.search(rf"useradd [^&]*\b{user}\b", made[0])
    assert re.search(rf"install -d -o {user} [^&]*{last(path, 'WORKDIR')}", made[0])
    assert json.loads(last(path, "ENTRYPOINT")) == ["instok3d"]
    assert json.loads(last(path, "CMD")) == ["demo"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_they_set_at_build_time_is_what_the_build_knows(path: Path):
    text = path.read_text()
    assert "cmake.define.INSTOK3D_OPENMP=OFF" in text
    assert "option(INSTOK3D_OPENMP " in (ROOT / "CMakeLists.txt").read_text()
    assert 'echo "$COMMIT" > COMMIT' in text
    assert "${CMAKE_CURRENT_SOURCE_DIR}/COMMIT" in (ROOT / "CMakeLists.txt").read_text()
    declared = {rest.split("=")[0] for name, rest in instructions(path) if name == "ARG"}
    named = set(re.findall(r"--build-arg '?([A-Z_]+)", PAGE))
    assert named <= {"COMMIT", "EXTRAS", "PIP_EXTRA_INDEX_URL", "TORCH"}
    assert declared <= named


def test_the_context_holds_what_a_wheel_is_made_of_and_no_more():
    needed = ["pyproject.toml", "README.md", "LICENSE", "NOTICE", "CMakeLists.txt", "src",
              "constraints-cpu.txt", "src/instok3d/assets/default_model.safetensors"]  # fmt: skip
    assert [path for path in needed if ignored(path)] == []
    assert [path for path in needed if not (ROOT / path).exists()] == []
    left_out = [".git", "tests", "docs", "build", "room.itk", "src/instok3d/__pycache__/a.pyc",
                "src/instok3d/render/_native.so", ".env"]  # fmt: skip
    assert [path for path in left_out if not ignored(path)] == []


def test_the_page_runs_commands_that_there_are(monkeypatch: pytest.MonkeyPatch):
    runs = re.findall(r"^docker run .* instok3d(?::cuda)?( .*)?$", PAGE, re.M)
    assert len(runs) == 4
    assert all(parses(words.split() or ["demo"], monkeypatch) for words in runs)
    built = re.findall(r"docker build -f (\S+)", PAGE)
    assert [ROOT / path for path in built] == FILES
