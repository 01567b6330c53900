"""GLB files: their triangles and colours as they are meant, or one sentence."""

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glb_files import block, glb, pack, square, table, unpack
from instok3d.rooms.catalogues.glb import MAX_BYTES, read_glb
from mutations import changed_value, of_bytes, survive

TEXTURE = np.arange(4 * 2 * 3, dtype=np.uint8).reshape(4, 2, 3) * 10


def written(folder: Path, data: bytes) -> Path:
    path = folder / "model.glb"
    path.write_bytes(data)
    return path


def test_parts_have_their_own_vertices_faces_and_linear_colours(tmp_path):
    top, column = read_glb(written(tmp_path, glb(table())))
    np.testing.assert_allclose(top.vertices.min(0), [-0.6, 0.71, -0.35], atol=1e-6)
    np.testing.assert_allclose(top.vertices.max(0), [0.6, 0.75, 0.35], atol=1e-6)
    assert top.faces.shape == (12, 3)
    np.testing.assert_array_equal(top.surface.factor, [0.5, 0, 0, 1])
    np.testing.assert_array_equal(column.surface.factor, [1, 1, 1, 1])  # the format's default
    assert top.uvs is None


def test_a_picture_is_decoded_with_its_coordinates(tmp_path):
    (part,) = read_glb(written(tmp_path, glb(square(TEXTURE))))
    assert part.surface.picture is not None
    assert part.uvs is not None
    np.testing.assert_array_equal(part.surface.picture[..., :3], TEXTURE)
    np.testing.assert_array_equal(part.uvs[0], [0, 1])


def test_a_node_scales_then_turns_then_shifts(tmp_path):
    # A quarter turn about y brings x to -z.
    half = 0.5**0.5
    node = {"scale": [2, 1, 1], "rotation": [0, half, 0, half], "translation": [0, 5, 0]}
    (part,) = read_glb(written(tmp_path, glb([block((0, 0, 0), (1, 1, 1))], node)))
    np.testing.assert_allclose(part.vertices[4], [0, 5, -2], atol=1e-9)  # was (1, 0, 0)
    matrix = {"matrix": [0, 0, -2, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 5, 0, 1]}  # the same, by columns
    (same,) = read_glb(written(tmp_path, glb([block((0, 0, 0), (1, 1, 1))], matrix)))
    np.testing.assert_allclose(same.vertices, part.vertices, atol=1e-9)


def test_a_mirrored_node_keeps_faces_turned_outwards(tmp_path):
    (part,) = read_glb(written(tmp_path, glb([block((0, 0, 0), (1, 1, 1))], {"scale": [-1, 1, 1]})))
    corners = part.vertices[part.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normals * (corners.mean(1) - part.vertices.mean(0))).sum(1) > 0).all()


def test_a_scene_without_nodes_has_no_parts(tmp_path):
    description, binary = unpack(glb(table()))
    description["scenes"] = [{}]
    assert read_glb(written(tmp_path, pack(description, binary))) == []


def change(data: bytes, **values: Any) -> bytes:
    description, binary = unpack(data)
    for key, value in values.items():
        *path, last = key.split("__")
        place: Any = description
        for step in path:
            place = place[int(step) if step.isdigit() else step]
        place[int(last) if last.isdigit() else last] = value
    return pack(description, binary)


BAD = {
    "it needs the extensions KHR_draco_mesh_compression": {
        "extensionsRequired": ["KHR_draco_mesh_compression"]
    },
    "accessor 0 reaches beyond its view": {"accessors__0__count": 9},
    "name vertices that are not there": {"accessors__0__count": 7},
    "its numbers lie outside the file": {"buffers__0__uri": "file:///etc/passwd"},
    "an accessor is sparse": {"accessors__0__sparse": {}},
    "a base colour is outside 0 to 1": {
        "materials__0__pbrMetallicRoughness__baseColorFactor": [2, 0, 0, 1]
    },
    "1 is none of 4": {"meshes__0__primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]},
    "it is posed by a skin": {"nodes__0__skin": 0},
    "node 0 stands twice": {"nodes__0__children": [0]},
    "no whole number from 0 to 0": {"scene": 3},
}


@pytest.mark.parametrize("reason", BAD)
def test_what_cannot_be_read_is_refused_with_the_reason(tmp_path, reason):
    path = written(tmp_path, change(glb(table()), **BAD[reason]))
    with pytest.raises(ValueError, match=rf"model\.glb is damaged \(.*{reason}.*take it out"):
        read_glb(path)


def test_pictures_outside_the_file_and_other_files_are_refused(tmp_path):
    outside = change(glb(square(TEXTURE)), images__0={"uri": "../secret.png"})
    with pytest.raises(ValueError, match="a picture lies outside the file"):
        read_glb(written(tmp_path, outside))
    with pytest.raises(ValueError, match="it is no GLB file"):
        read_glb(written(tmp_path, b"solid x\n" * 9))
    with pytest.raises(ValueError, match=r"version 2 of \d+ bytes"):
        read_glb(written(tmp_path, glb(table())[:-4]))
    with pytest.raises(FileNotFoundError, match=r"there is no file .*none\.glb"):
        read_glb(tmp_path / "none.glb")


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    path = tmp_path / "model.glb"
    with path.open("wb") as stream:
        stream.truncate(MAX_BYTES + 1)
    with pytest.raises(ValueError, match=r"model\.glb has 67,108,865 bytes, more than 67,108,864"):
        read_glb(path)


def of_glb(data: bytes, rng: random.Random) -> bytes:
    """The description's JSON changed, or as `of_bytes`."""
    if rng.random() < 0.3:
        return of_bytes(data, rng)
    description, binary = unpack(data)
    return pack(changed_value(description, rng), binary)


@pytest.mark.parametrize("parts", [table(), square(TEXTURE)], ids=["colours", "picture"])
def test_damage_of_any_kind_is_read_or_refused_in_one_line(tmp_path, parts):
    path = written(tmp_path, glb(parts))
    assert survive(path, lambda: read_glb(path), of_glb, 250)
