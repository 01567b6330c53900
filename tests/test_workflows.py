"""The workflows parse, run what the README says, and agree with pyproject.toml."""

import re
import shlex
import tomllib
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from command_lines import parses
from instok3d.render import native_status

yaml = pytest.importorskip("yaml")

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".github" / "workflows"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
WHEELS = PYPROJECT["tool"]["cibuildwheel"]


def workflow(name: str) -> dict[str, Any]:
    return yaml.safe_load((FOLDER / f"{name}.yml").read_text())


def steps(name: str) -> list[dict[str, Any]]:
    return [step for job in workflow(name)["jobs"].values() for step in job.get("steps", [])]


def test_there_are_workflows_for_tests_wheels_and_releases():
    assert {path.name for path in FOLDER.iterdir()} == {"tests.yml", "wheels.yml", "release.yml"}


@pytest.mark.parametrize("name", ["tests", "wheels", "release"])
def test_every_job_can_run_and_may_only_read_unless_it_says_so(name: str):
    content = workflow(name)
    assert content["permissions"] == {"contents": "read"}
    assert content[True]  # what YAML makes of the key `on`
    for job in content["jobs"].values():
        if "uses" in job:
            assert (ROOT / job["uses"]).is_file()
            continue
        assert job["runs-on"]
        assert all(("run" in step) != ("uses" in step) for step in job["steps"])
        needed = job.get("needs", [])
        assert set([needed] if isinstance(needed, str) else needed) <= set(content["jobs"])


def test_the_tests_are_run_by_the_commands_of_the_readme_word_for_word():
    section = (ROOT / "README.md").read_text().split("\n## Tests\n")[1]
    commands = re.findall(r"```bash\n(.*?)```", section, re.S)[0]
    assert commands in [step.get("run") for step in steps("tests")]


def test_linter_and_type_checker_run_as_in_the_script_for_clean_machines():
    script = (ROOT / ".ci" / "run").read_text().splitlines()
    checks = next(step["run"] for step in steps("tests") if "ruff" in step.get("run", ""))
    assert set(checks.splitlines()) <= set(script)


def test_tests_wheels_and_classifiers_are_of_the_same_versions_of_python():
    tested = workflow("tests")["jobs"]["tests"]["strategy"]["matrix"]["python"]
    prefix = "Programming Language :: Python :: 3."
    named = [x for x in PYPROJECT["project"]["classifiers"] if x.startswith(prefix)]
    assert tested == [x.rsplit(" ", 1)[1] for x in named]
    assert WHEELS["build"] == [f"cp{version.replace('.', '')}-*" for version in tested]
    assert PYPROJECT["project"]["requires-python"] == f">={tested[0]}"


def test_commands_that_try_a_wheel_are_commands(monkeypatch: pytest.MonkeyPatch):
    words = [shlex.split(command) for command in WHEELS["test-command"]]
    ours = [each[1:] for each in words if each[0] == "instok3d" and each[1] != "--version"]
    assert ["demo"] in ours
    assert all(parses(each, monkeypatch) for each in ours)
    (check,) = [each for each in words if each[0] == "python"]
    # It must end with an error exactly where a wheel lacks its kernels.
    outcome = nullcontext() if native_status().available else pytest.raises(AssertionError)
    with outcome:
        exec(check[2])


def test_a_wheel_is_built_for_each_system_with_the_option_that_cmake_knows():
    systems = workflow("wheels")["jobs"]["wheels"]["strategy"]["matrix"]["include"]
    assert {entry["system"].split("-")[0] for entry in systems} == {"ubuntu", "macos", "windows"}
    (option,) = WHEELS["config-settings"]
    assert (
        f"option({option.removeprefix('cmake.define.')} " in (ROOT / "CMakeLists.txt").read_text()
    )


@pytest.mark.parametrize(
    "path", [*FOLDER.iterdir(), ROOT / "pyproject.toml"], ids=lambda path: path.name
)
def test_no_address_but_that_of_the_repository_is_named(path: Path):
    hosts = re.findall(r"//([\w.-]+\.\w+)/", path.read_text())
    assert set(hosts) <= {"github.com"}
