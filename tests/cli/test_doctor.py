"""`instok3d doctor`, and that what it and other messages tell people to install or run exists."""

import ast
import inspect
import json
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.machinery import ModuleSpec
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path

import pytest

from instok3d.cli import COMMANDS, main
from instok3d.cli.doctor import DEFAULT_VIEWS, GSPLAT, OPTIONAL
from instok3d.cli.reconstruct import run as reconstruct
from instok3d.model.files import DEFAULT_MODEL
from instok3d.render import native_backend

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
TEXTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *SOURCES]


def doctor(capsys: pytest.CaptureFixture[str]) -> dict[str, dict]:
    code = 0 if DEFAULT_MODEL.is_file() else 4
    assert main(["doctor", "--json"]) == code
    return {line["name"]: line for line in json.loads(capsys.readouterr().out)["findings"]}


def test_doctor_reports_each_finding_on_a_line(capsys: pytest.CaptureFixture[str]):
    findings = doctor(capsys)
    assert {"torch", "native kernels", "default model", "memory"} <= set(findings)
    assert main(["doctor"]) == (0 if DEFAULT_MODEL.is_file() else 4)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [
        "ok" if finding["good"] else "LACK" for finding in findings.values()
    ]


def test_doctor_says_whether_each_optional_package_is_there(capsys: pytest.CaptureFixture[str]):
    findings = doctor(capsys)
    for module, (extra, _) in OPTIONAL.items():
        there = find_spec(module) is not None
        assert findings[module]["state"].startswith("there" if there else "not installed")
        assert there or f"pip install 'instok3d[{extra}]'" in findings[module]["state"]


@cache
def distributions() -> Mapping[str, list[str]]:
    """The installed packages that bring each module."""
    return packages_distributions()


@cache
def named_in_the_code() -> frozenset[str]:
    """The first words of what the code imports, or names in a string."""
    return frozenset(
        word.split(".")[0]
        for path in SOURCES
        if path.name != "doctor.py"
        for node in ast.walk(ast.parse(path.read_text()))
        for word in (
            [alias.name for alias in node.names] if isinstance(node, ast.Import)
            else [node.module or ""] if isinstance(node, ast.ImportFrom)
            else [node.value] if isinstance(node, ast.Constant) and isinstance(node.value, str)
            else []
        )
    )  # fmt: skip


@pytest.mark.parametrize("module", OPTIONAL)
def test_the_extra_that_doctor_names_brings_the_module(module: str):
    extra, _ = OPTIONAL[module]
    if find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    brought = {re.split(r"[\[<>=~]", each)[0].replace("-", "_").lower() for each in EXTRAS[extra]}
    there = {name.replace("-", "_").lower() for name in distributions()[module]}
    assert brought & there


@pytest.mark.parametrize("module", OPTIONAL)
def test_the_code_uses_the_module_that_doctor_looks_for(module: str):
    assert module in named_in_the_code()


@pytest.mark.parametrize("built", [False, True])
def test_kernels_that_are_missing_are_a_lack_with_what_to_do(
    built: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(native_backend, "_rasterizer", None)
    monkeypatch.setattr(native_backend, "_import_error", "libgomp.so.1: cannot open")
    monkeypatch.setattr(
        native_backend, "find_spec", lambda name: ModuleSpec(name, None) if built else None
    )
    finding = doctor(capsys)["native kernels"]
    assert not finding["good"]
    # Advice to install a compiler would be wrong where the module is there and does not load.
    assert ("does not load: libgomp.so.1" in finding["state"]) == built
    assert ("C++ compiler" in finding["state"]) == (not built)


def test_doctor_knows_the_pinned_gsplat_and_the_number_of_views_of_reconstruct():
    assert EXTRAS["gpu"] == [f"gsplat=={GSPLAT}"]
    assert inspect.signature(reconstruct).parameters["max_views"].default == DEFAULT_VIEWS


def test_every_extra_that_is_named_anywhere_exists():
    named = {
        extra
        for path in TEXTS
        for extras in re.findall(r"(?:instok3d|'\.)\[([a-z,]+)\]", path.read_text())
        for extra in extras.split(",")
    }
    assert {"rooms", "gpu", "models"} <= named
    assert named <= set(EXTRAS)


def test_commands_with_extras_are_quoted_for_shells_that_expand_brackets():
    for path in TEXTS:
        assert not re.search(r"pip install [^'\n]*\w\[[a-z]", path.read_text()), path


def test_every_command_that_is_named_anywhere_exists():
    named = {
        name for path in TEXTS for name in re.findall(r"`instok3d ([a-z0-9]+)", path.read_text())
    }
    assert {"reconstruct", "doctor", "data"} <= named
    assert named <= set(COMMANDS)
