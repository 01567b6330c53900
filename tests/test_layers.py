"""A file imports only from its own folder and from folders before it in ORDER."""

import ast
from importlib.util import resolve_name
from pathlib import Path

import pytest

import instok3d

ROOT = Path(__file__).resolve().parents[1] / "src" / "instok3d"
ORDER = ["types", "errors", "version", "progress", "renames", "locking", "files", "reading",
         "hub", "transformers_models", "binary_gltf", "pictures", "geometry", "render", "photos",
         "sfm",
         "data", "rooms", "datasets", "weights", "backbones", "model", "semantics", "objectives",
         "refinement", "scene", "webpage", "formats", "library", "batch", "evaluation",
         "baselines", "training", "tables", "viewer", "service", "cli"]  # fmt: skip

FOR_PEOPLE = {"scene/scene.py": {"viewer"}}
"""Imported late by a method that only people call: `scene.view()`."""


def imported_modules(tree: ast.AST, package: str) -> set[str]:
    """Full names of what a file of this package imports, one for each name behind `from`."""
    modules = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), package)
            modules |= {f"{module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call) and node.args:
            function, first = node.func, node.args[0]
            called = getattr(function, "id", None) or getattr(function, "attr", None)
            parts = first.values[:1] if isinstance(first, ast.JoinedStr) else [first]
            if called in ("import_module", "__import__") and isinstance(parts[0], ast.Constant):
                modules.add(str(parts[0].value))
    return modules


def imported_layers(tree: ast.AST, package: str = "instok3d.model") -> set[str]:
    """Folders of the package that a file depends on.

    The package itself stands for all of them: whoever has it reaches every folder.
    """
    layers = set()
    for module in imported_modules(tree, package):
        root, *below = module.split(".")
        if root != "instok3d" or below == ["__version__"]:
            continue
        home = instok3d._HOMES.get(below[0], "") if below else ""
        layers.add(home.split(".")[1] if home else below[0] if below else ORDER[-1])
    return {ORDER[-1] if layer == "*" else layer for layer in layers}


def test_imports_point_back():
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).parts
        layer = parts[0].removesuffix(".py")
        if layer in ("__init__", "__main__"):
            continue
        assert layer in ORDER, f"{path.relative_to(ROOT)}: give the folder a place in ORDER"
        package = ".".join(["instok3d", *parts[:-1]])
        found = imported_layers(ast.parse(path.read_text()), package)
        unknown = found - set(ORDER)
        assert not unknown, f"{path.relative_to(ROOT)} imports {unknown}, which ORDER does not have"
        found -= FOR_PEOPLE.get(path.relative_to(ROOT).as_posix(), set())
        later = [name for name in found if ORDER.index(name) > ORDER.index(layer)]
        assert not later, f"{path.relative_to(ROOT)} imports {later}, which come after {layer}"


@pytest.mark.parametrize(
    ("line", "layers"),
    [
        ("from instok3d.cli.main import x", {"cli"}),
        ("import instok3d.training.loop", {"training"}),
        ("import instok3d.training.loop as loop, torch", {"training"}),
        ("from instok3d import cli", {"cli"}),
        ("from ..cli import x", {"cli"}),
        ("from ..cli.main import x", {"cli"}),
        ("from .. import training, types", {"training", "types"}),
        ("from . import tokenizer", {"model"}),
        ("from .tokenizer import Tokenizer", {"model"}),
        ("import instok3d", {"cli"}),
        ("import instok3d as package", {"cli"}),
        ("from instok3d import *", {"cli"}),
        ("from .. import *", {"cli"}),
        ("from instok3d import reconstruct", {"scene"}),
        ("from .. import Scene", {"scene"}),
        ("def later():\n    from ..cli import x", {"cli"}),
        ("import_module('instok3d.cli.data')", {"cli"}),
        ("importlib.import_module(f'instok3d.cli.{name}')", {"cli"}),
        ("from instok3d import __version__", set()),
        ("import torch, instok3dextra\nfrom collections.abc import Sequence", set()),
    ],
)
def test_every_kind_of_import_is_seen(line: str, layers: set[str]):
    assert imported_layers(ast.parse(line)) == layers


def test_a_relative_import_is_of_the_folder_that_the_file_is_in():
    tree = ast.parse("from ...cli import x\nfrom .. import memory\nfrom . import windows")
    assert imported_layers(tree, "instok3d.model.views") == {"cli", "model"}
