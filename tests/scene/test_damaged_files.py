"""A damaged scene folder, PLY or path of cameras is read, or refused in one line."""

import json
from pathlib import Path

import pytest

from instok3d.files import sha256_of
from instok3d.scene.files import load_record
from instok3d.scene.paths import read_camera_path
from instok3d.scene.scene import Scene
from mutations import Damage, of_bytes, of_json, of_safetensors, survive


@pytest.mark.parametrize(
    ("name", "damage", "count"),
    [
        ("scene.json", of_json, 80),
        ("cameras.json", of_json, 80),
        ("objects.json", of_json, 80),
        ("gaussians.safetensors", of_safetensors, 80),
        ("tokens.safetensors", of_safetensors, 80),
        ("inputs/000.png", of_bytes, 40),
    ],
)
def test_a_scene_folder(tmp_path: Path, scene: Scene, name: str, damage: Damage, count: int):
    folder = tmp_path / "room.itk"
    scene.save(folder)
    header = json.loads((folder / "scene.json").read_text())

    def read() -> None:
        if name in header["sha256"]:  # else nothing but the hash would be looked at
            digests = header["sha256"] | {name: sha256_of(folder / name)}
            (folder / "scene.json").write_text(json.dumps(header | {"sha256": digests}))
        load_record(folder)

    assert survive(folder / name, read, damage, count)
    load_record(folder) if name not in header["sha256"] else read()


def test_a_path_of_cameras(tmp_path: Path, scene: Scene):
    scene.save(tmp_path / "room.itk")
    file = tmp_path / "room.itk" / "cameras.json"
    assert survive(file, lambda: read_camera_path(file), of_json, 100)
