"""docs/formats.md names what the files hold, no more and no less."""

import dataclasses
import json
import re
from pathlib import Path

import pytest

from instok3d.evaluation.outlines import FORMAT as OUTLINES_FORMAT
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
    assert keys_of_table(f"**`{name}`**") == set(value if isinstance(value, dict) else value[0])


@pytest.mark.parametrize(("name", "kind"), [("gaussians", Gaussians), ("tokens", SceneTokens)])
def test_every_tensor_of_a_scene_is_on_the_page(name: str, kind: type):
    (line,) = [line for line in PAGE.splitlines() if line.startswith(f"| `{name}.safetensors` |")]
    assert set(re.findall(r"`(\w+)`", line)) == {field.name for field in dataclasses.fields(kind)}


def test_versions_are_those_of_the_program():
    assert f"| scene folder | `version` of `scene.json` | {VERSION} |" in PAGE
    for version in (MODEL_FORMAT, ROOMS_FORMAT, OUTLINES_FORMAT):
        assert f"| `{version}` |" in PAGE
