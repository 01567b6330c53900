"""docs/formats.md names what the files hold, no more and no less."""

import dataclasses
import json
import re
from pathlib import Path

import pytest

from instok3d.evaluation.outlines import FORMAT as OUTLINES_FORMAT
from instok3d.formats.layouts import LAYOUTS
from instok3d.formats.object_folder import FORMAT as OBJECTS
from instok3d.formats.registry import FORMATS
from instok3d.formats.sidecar import FORMAT as SIDECAR
from instok3d.hub.manifest import FORMAT as HUB_FORMAT
from instok3d.model.files import FORMAT as MODEL_FORMAT
from instok3d.rooms.shards import FORMAT as ROOMS_FORMAT
from instok3d.scene.record import SceneTokens
from instok3d.scene.scene import Scene
from instok3d.scene.versions import VERSION
from instok3d.types import Gaussians
from made_scene import made_scene, made_tokens

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "formats.md").read_text()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene: Scene = made_scene(made_tokens())
    path = tmp_path_factory.mktemp("formats") / "room.itk"
    scene.save(path)
    return path


def keys_of_table(title: str) -> set[str]:
    table = PAGE.split(title, 1)[1].split("\n\n")[1]
    first_cells = [line.split("|")[1] for line in table.splitlines()[2:]]
    return {key for cell in first_cells for key in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize("name", ["scene.json", "cameras.json", "objects.json"])
def test_every_key_of_a_scene_is_on_the_page(folder: Path, name: str):
    value = json.loads((folder / name).read_text())
    value = value["objects"] if name == "objects.json" else value
    assert keys_of_table(f"**`{name}`**") == set(value if isinstance(value, dict) else value[0])


@pytest.mark.parametrize(("name", "kind"), [("gaussians", Gaussians), ("tokens", SceneTokens)])
def test_every_tensor_of_a_scene_is_on_the_page(name: str, kind: type):
    (line,) = [line for line in PAGE.splitlines() if line.startswith(f"| `{name}.safetensors` |")]
    assert set(re.findall(r"`(\w+)`", line)) == {field.name for field in dataclasses.fields(kind)}


def test_versions_are_those_of_the_program():
    assert f"| scene folder | `version` of `scene.json` | {VERSION} |" in PAGE
    for version in (MODEL_FORMAT, ROOMS_FORMAT, OUTLINES_FORMAT, HUB_FORMAT):
        assert f"| `{version}` |" in PAGE


def test_every_format_of_other_programs_is_on_the_page():
    table = keys_and_marks("| ending |")
    assert {each.suffix for each in FORMATS} == {key for key in table if key.startswith(".")}
    for each in FORMATS:
        out, read = table[each.suffix][:2]
        assert (out.startswith("yes"), read.startswith("yes")) == (
            bool(each.writer), bool(each.reader)
        ), each.suffix  # fmt: skip
    assert set(keys_and_marks("| name | makes |")) == set(LAYOUTS)
    assert f'"{SIDECAR}"' in PAGE
    assert f'"{OBJECTS}"' in PAGE


def keys_and_marks(head: str) -> dict[str, list[str]]:
    """The cells behind the first one of each row of a table, by what the first has in backticks."""
    table = head + PAGE.split(head, 1)[1].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
    return {cells[0].strip("`"): cells[1:] for cells in rows if cells[0].startswith("`")}
