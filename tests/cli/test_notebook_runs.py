"""The notebook of examples/ runs from its first cell to its last, as a person would run it."""

import json
import re
import shutil
from pathlib import Path

import pytest

import instok3d
from shipped_demo import ShippedDemo

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

FILE = Path(__file__).resolve().parents[2] / "examples" / "notebook.ipynb"


def test_it_is_kept_without_outputs_and_in_form():
    book = nbformat.read(FILE, as_version=4)
    nbformat.validate(book)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert len(code) >= 6
    assert all(cell.outputs == [] and cell.execution_count is None for cell in code)
    text = FILE.read_text()
    assert text == json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"


def test_it_runs_from_the_photos_to_an_edited_scene(shipped_demo: ShippedDemo, tmp_path: Path):
    shutil.copytree(shipped_demo.scene, tmp_path / "demo.itk")  # made by what its cell would call
    book = nbformat.read(FILE, as_version=4)
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(book, timeout=300, kernel_name="python3", resources=where).execute()
    shown = {cell.id: cell.outputs for cell in book.cells if cell.cell_type == "code"}
    assert "contact sheet of the scene" in shown["scene"][-1].data["text/html"]
    for name in ("between", "remove", "move"):
        assert "image/png" in shown[name][-1].data, name
    printed = {name: each[0].text for name, each in shown.items() if "text" in each[0]}
    assert len(printed["list"].splitlines()) == len(shipped_demo.made["objects"])
    assert "chair" in printed["words"]
    assert int(re.findall(r"(\d+) Gaussians are invented", printed["remove"])[0]) > 0
    assert len(instok3d.load(tmp_path / "moved.itk").edits) == 2
    assert (tmp_path / "moved.html").stat().st_size > 100_000
    assert (tmp_path / "moved.ply").is_file()
