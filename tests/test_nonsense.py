"""Each reader against each kind of nonsense: refused in one sentence that names the file.

What data sets are documented to do instead is held here too: single frames with unusable poses are
dropped and counted, and so are single Gaussians of a PLY. A cell that a format cannot express
stands in a table with the reason.
"""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

from instok3d.datasets.prepared import DroppedFrame, PreparedFrame, PreparedScenes
from instok3d.files import sha256_of
from instok3d.formats.ply import read_ply, write_ply
from instok3d.photos.depth_files import read_depth
from instok3d.photos.loading import load_photos
from instok3d.scene.files import load_record
from instok3d.types import check_gaussians
from made_scene import made_scene, made_tokens
from nonsense_readers import READERS, Camera, feature_cache, sound_camera
from prepared_scenes import made_folder


def pose(change: Callable[[np.ndarray], object], *numbers: float) -> Callable[[Camera], Camera]:
    """A change of the pose, and what it is as seven numbers; none where there is no such thing."""

    def apply(camera: Camera) -> Camera:
        matrix = camera.pose.copy()
        change(matrix)
        return replace(camera, pose=matrix, numbers=list(numbers))

    return apply


def entry(row: int, column: int, value: float) -> Callable[[np.ndarray], object]:
    return lambda matrix: matrix.__setitem__((row, column), value)


def lens(row: int, column: int, value: float) -> Callable[[Camera], Camera]:
    def apply(camera: Camera) -> Camera:
        matrix = camera.intrinsics.copy()
        matrix[row, column] = value
        return replace(camera, intrinsics=matrix)

    return apply


NAN, INF = math.nan, math.inf
POSES = {
    "stretched rotation": pose(lambda m: m.__setitem__((slice(3), slice(3)), 2 * np.eye(3)),
                               2, 0, 0, 0, 0, 0, 0),
    "zero rotation": pose(lambda m: m.__setitem__((slice(3), slice(3)), 0), 0, 0, 0, 0, 0, 0, 0),
    "sheared rotation": pose(entry(0, 1, 0.3)),
    "reflection": pose(entry(2, 2, -1.0)),
    "NaN in the rotation": pose(entry(0, 1, NAN), 1, NAN, 0, 0, 0, 0, 0),
    "infinite rotation": pose(entry(1, 1, INF), INF, 0, 0, 0, 0, 0, 0),
    "NaN in the position": pose(entry(0, 3, NAN), 1, 0, 0, 0, NAN, 0, 0),
    "infinite position": pose(entry(1, 3, -INF), 1, 0, 0, 0, 0, -INF, 0),
    "position beyond single precision": pose(entry(2, 3, 1e30), 1, 0, 0, 0, 0, 0, 1e30),
    "another last row": pose(entry(3, 0, 1.0)),
}  # fmt: skip
LENSES = {
    "focal length 0": lens(0, 0, 0.0),
    "focal length below 0": lens(1, 1, -1.0),
    "focal length NaN": lens(0, 0, NAN),
    "focal length infinite": lens(1, 1, INF),
    "focal length of another size": lens(0, 0, 1e6),
    "middle NaN": lens(0, 2, NAN),
    "middle infinite": lens(1, 2, INF),
    "middle of another picture": lens(0, 2, 50.0),
    "a number below the diagonal": lens(1, 0, 0.5),
    "skew": lens(0, 1, 0.5),
    "intrinsics with another last row": lens(2, 0, 0.5),
}
CAMERAS = POSES | LENSES
BY_QUATERNION = "a pose that is a quaternion and a translation cannot say that"
BY_ROWS = "a pose of three rows has no last one"
BY_NUMBERS = "two focal lengths and a middle stand in place of a matrix"
PREDICTED = "a network said where the middle is: it may lie anywhere"
LEFT_OUT = {
    **{(reader, nonsense): BY_QUATERNION
       for reader in ("colmap_text", "colmap_binary")
       for nonsense in ("sheared rotation", "reflection", "another last row")},
    ("re10k_text", "another last row"): BY_ROWS,
    **{(reader, nonsense): BY_NUMBERS
       for reader in ("colmap_text", "colmap_binary", "transforms_json", "re10k_text")
       for nonsense in ("a number below the diagonal", "skew", "intrinsics with another last row")},
    ("feature_cache", "middle of another picture"): PREDICTED,
}  # fmt: skip
"""Cells that a format cannot express, or for which it is no nonsense; with the reason."""
DROPPING = ("sens", "scannet_processed", "scannet_lsm", "re10k_text")
"""Data sets whose frames without a usable pose are dropped and counted (docs/data.md)."""


CELLS = [cell for cell in product(READERS, CAMERAS) if cell not in LEFT_OUT]


def refusal(read: Callable[[], object], named: str) -> str:
    with pytest.raises(ValueError, match=named) as error:
        read()
    message = str(error.value)
    assert "\n" not in message
    assert len(message) < 500
    return message


@pytest.mark.parametrize("reader", READERS)
def test_sound_cameras_are_read(tmp_path: Path, reader: str):
    found = READERS[reader](tmp_path, sound_camera()).read()
    if reader in DROPPING:
        assert isinstance(found, list)
        assert [type(each) for each in found] == [PreparedFrame] * 2


@pytest.mark.parametrize(("reader", "nonsense"), CELLS)
def test_a_camera_that_cannot_be(tmp_path: Path, reader: str, nonsense: str):
    written = READERS[reader](tmp_path, CAMERAS[nonsense](sound_camera()))
    drops = reader in DROPPING and (nonsense in POSES or reader == "re10k_text")
    if not drops:
        refusal(written.read, rf"{written.file.name}")
        return
    frames = written.read()
    assert isinstance(frames, list)
    sound, bad = frames
    assert isinstance(sound, PreparedFrame)
    assert isinstance(bad, DroppedFrame)
    assert bad.reason


GAUSSIANS: dict[str, tuple[str, tuple[int, ...], float]] = {
    "NaN in a centre": ("means", (1, 0), NAN),
    "infinite centre": ("means", (1, 2), INF),
    "centre beyond single precision": ("means", (1, 2), 1e30),
    "scale 0": ("scales", (1, 1), 0.0),
    "scale below 0": ("scales", (1, 1), -1.0),
    "infinite scale": ("scales", (1, 1), INF),
    "NaN in a scale": ("scales", (1, 0), NAN),
    "opacity below 0": ("opacities", (1,), -0.1),
    "opacity above 1": ("opacities", (1,), 1.5),
    "NaN as opacity": ("opacities", (1,), NAN),
    "quaternion of length 0": ("quats", (1,), 0.0),
    "quaternion of length 2": ("quats", (1,), 1.0),
    "NaN in a quaternion": ("quats", (1, 3), NAN),
    "infinite colour": ("sh", (1, 0, 0), INF),
    "NaN in a colour": ("sh", (1, 3, 2), NAN),
    "anchor below 0": ("anchor_index", (1,), -1),
    "anchor that is not there": ("anchor_index", (1,), 1000),
}


@pytest.mark.parametrize("nonsense", GAUSSIANS)
def test_gaussians_of_a_scene_folder_that_cannot_be(tmp_path: Path, nonsense: str):
    folder, (field, place, value) = tmp_path / "room.itk", GAUSSIANS[nonsense]
    made_scene(made_tokens()).save(folder)
    file = folder / "gaussians.safetensors"
    tensors = load_file(file)
    tensors[field][place] = value
    save_file(tensors, file)
    header = json.loads((folder / "scene.json").read_text())
    header["sha256"][file.name] = sha256_of(file)
    (folder / "scene.json").write_text(json.dumps(header))
    refusal(lambda: load_record(folder), r"gaussians\.safetensors")


@pytest.mark.parametrize("nonsense", [key for key in GAUSSIANS if "anchor that" not in key])
def test_gaussians_that_cannot_be_are_not_saved(tmp_path: Path, nonsense: str):
    field, place, value = GAUSSIANS[nonsense]
    scene = made_scene(made_tokens())
    tensor = getattr(scene.gaussians, field).clone()
    tensor[place] = value
    changed = replace(scene, gaussians=replace(scene.gaussians, **{field: tensor}))
    refusal(lambda: changed.save(tmp_path / "room.itk"), "the scene has")
    assert not list(tmp_path.iterdir())


PLY = {
    "NaN in a centre": ("x", NAN, "dropped"),
    "infinite centre": ("z", -INF, "dropped"),
    "centre beyond single precision": ("y", 1e30, "dropped"),
    "scale 0": ("scale_1", -INF, "kept"),
    "infinite scale": ("scale_1", INF, "dropped"),
    "scale of an infinite length": ("scale_0", 1000.0, "kept"),
    "NaN in a scale": ("scale_2", NAN, "dropped"),
    "opacity 1 as an infinite logit": ("opacity", INF, "kept"),
    "opacity 0 as an infinite logit": ("opacity", -INF, "kept"),
    "NaN as opacity": ("opacity", NAN, "dropped"),
    "quaternion of length 0": ("rot_0 rot_1 rot_2 rot_3", 0.0, "dropped"),
    "quaternion of length 2": ("rot_0 rot_1 rot_2 rot_3", 1.0, "kept"),
    "NaN in a quaternion": ("rot_3", NAN, "dropped"),
    "infinite quaternion": ("rot_0", INF, "dropped"),
    "infinite colour": ("f_dc_0", INF, "dropped"),
    "NaN in a colour": ("f_rest_7", NAN, "dropped"),
}
"""Lengths are logarithms there and opacities logits, so none lies below 0 or above 1."""


@pytest.mark.parametrize("nonsense", PLY)
def test_gaussians_of_a_ply_that_cannot_be_are_dropped_with_their_number(
    tmp_path: Path, nonsense: str
):
    columns, value, fate = PLY[nonsense]
    gaussians, file = made_scene(made_tokens()).gaussians, tmp_path / "a.ply"
    write_ply(file, gaussians)
    data = file.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    names = [line.split()[-1] for line in data[:start].decode().splitlines() if "float" in line]
    rows = np.frombuffer(data[start:], "<f4").reshape(len(gaussians.means), -1).copy()
    for column in columns.split():
        rows[1, names.index(column)] = value
    file.write_bytes(data[:start] + rows.tobytes())
    found = read_ply(file)
    check_gaussians(found.gaussians, file)
    lost = len(gaussians.means) - len(found.gaussians.means)
    if fate == "kept":
        assert (lost, found.notes) == (0, ())
    else:
        (note,) = found.notes
        assert lost == 1
        assert "dropped 1 Gaussian" in note


DEPTHS = {"NaN": NAN, "infinite": INF, "below 0": -1.0, "below 0 and infinite": -INF}


@pytest.mark.parametrize("nonsense", DEPTHS)
def test_depth_of_a_feature_cache_that_cannot_be(tmp_path: Path, nonsense: str):
    depths = torch.ones(2, 16, 16)
    depths[1, 3, 4] = DEPTHS[nonsense]
    written = feature_cache(tmp_path, sound_camera(), depths=depths)
    refusal(written.read, written.file.name)


@pytest.mark.parametrize("ending", [".npy", ".tiff"])
@pytest.mark.parametrize("nonsense", DEPTHS)
def test_depth_of_a_sensor_that_cannot_be_is_unknown(tmp_path: Path, nonsense: str, ending: str):
    depth = np.full((6, 8), 2.0, np.float32)
    depth[3, 4] = DEPTHS[nonsense]
    file = tmp_path / f"depth{ending}"
    np.save(file, depth) if ending == ".npy" else Image.fromarray(depth).save(file)
    expected = torch.full((6, 8), 2.0)
    expected[3, 4] = 0
    assert torch.equal(read_depth(file, scale=1.0), expected)


@pytest.mark.parametrize("layer", ["depths", "instances"])
def test_depth_and_ids_of_a_prepared_scene_in_fewer_than_16_bits(tmp_path: Path, layer: str):
    """Depth of rooms, prepared scenes and scans is of whole numbers, which are never below 0."""
    made_folder(tmp_path, {"a": "train"}, num_frames=2)
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(tmp_path / "a" / layer / "000001.png")
    source = PreparedScenes(tmp_path)
    source.frames(0, [0])
    refusal(lambda: source.frames(0, [1]), rf"{layer}/000001\.png has pixels of the mode L, wanted")


GREY = {"NaN": NAN, "infinite": INF, "below 0": -0.5, "above 1": 1e30}


@pytest.mark.parametrize("nonsense", GREY)
def test_photos_in_floating_point_that_cannot_be(tmp_path: Path, nonsense: str):
    pixels = np.full((32, 32), 0.5, np.float32)
    pixels[3, 4] = GREY[nonsense]
    file = tmp_path / "photo.tiff"
    Image.fromarray(pixels).save(file)
    refusal(lambda: load_photos([file], height=32, width=32), r"photo\.tiff")


NUMBERS = {
    "scene.json": [("near_far", 0), ("vertical", "confidence"), ("height",)],
    "cameras.json": [(0, "pixel_map", "scale_x"), (0, "pixel_map", "offset_y")],
    "objects.json": [("objects", 0, "obb", "center", 0), ("objects", 0, "aabb", "min", 1)],
}


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_of_a_scene_folder_that_cannot_be(tmp_path: Path, name: str, value: float):
    folder = tmp_path / "room.itk"
    made_scene(made_tokens()).save(folder)
    whole = (folder / name).read_text()
    for place in NUMBERS[name]:
        content = json.loads(whole)
        holder = content
        for key in place[:-1]:
            holder = holder[key]
        assert isinstance(holder[place[-1]], int | float)
        holder[place[-1]] = value
        (folder / name).write_text(json.dumps(content))
        refusal(lambda: load_record(folder), name)
