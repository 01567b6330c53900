import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from shipped_demo import ShippedDemo

# Before torch: beside another busy process, threads that spin while they wait for each other make
# many small parallel regions take up to forty times as long.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import torch
from jaxtyping import install_import_hook

import annotations

# Before anything of instok3d is imported: every jaxtyping annotation is checked in every test.
install_import_hook("instok3d", "annotations.checked")

WHOLE = Path(__file__).parent / "whole"
SHARED = Path(__file__).resolve().parents[1].parent / "shared"

# As many processes as cores run tests side by side (pyproject.toml), each on one thread.
torch.set_num_threads(1 if "PYTEST_XDIST_WORKER" in os.environ else min(2, os.cpu_count() or 1))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect without looking for garbage, and leave what came of it out of every later search."""
    gc.disable()
    yield
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Iterator[None, pytest.CollectReport, pytest.CollectReport]:
    """Have every other process read folders backwards.

    On a clean machine nothing is compiled yet. So each process compiles about half of the files and
    finds the other half compiled by its neighbour, instead of compiling all of them beside it.
    """
    report = yield
    if isinstance(collector, pytest.Directory) and reads_backwards():
        report.result.reverse()
    return report


def reads_backwards() -> bool:
    return int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 2 == 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # The same order in all processes, whichever way they read. The longest test of all would
    # otherwise be the last one, for which other processes wait.
    items.sort(key=lambda item: (WHOLE not in item.path.parents, item.path.parts))
    if torch.cuda.is_available():
        return
    skip = pytest.mark.skip(reason="needs a CUDA device")
    for item in items:
        if "gpu" in item.keywords:
            item.add_marker(skip)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    annotations.check_anew()


@pytest.fixture
def rng() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real test data beside the project; skips where it is absent."""
    if not SHARED.is_dir():
        pytest.skip(f"real test data is not here: no folder {SHARED.name}/ beside the project")
    return SHARED


@pytest.fixture(scope="session")
def shipped_demo(tmp_path_factory: pytest.TempPathFactory) -> "ShippedDemo":
    """What `instok3d demo` made, once for all processes; skips where a tree lacks the model."""
    from shipped_demo import is_shipped, make_demo

    if not is_shipped():
        pytest.skip("the default model and the demo's photos are not in this tree")
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # that of the run, of which each process has a folder
    (folder / "shipped_demo").mkdir(exist_ok=True)
    return make_demo(folder / "shipped_demo")


@pytest.fixture
def plane(monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of the backbone of tests/plane_backbone.py, which is registered for one test."""
    from instok3d.backbones import register_backbone, registry
    from plane_backbone import PLANE

    monkeypatch.setattr(registry, "_REGISTERED", {})
    register_backbone("plane", PLANE)
    return "plane"
