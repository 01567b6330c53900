"""Whatever a cache holds in the place of what was written: one sentence that names the file."""

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from instok3d.data.sample import Sample
from instok3d.training.cache.checks import check_answer
from instok3d.training.cache.features import FeatureCache
from instok3d.types import Views

SHA256 = "ab" * 32
SETTINGS: dict[str, Any] = {
    "backbone": {"width": 8}, "backbone_sha256": SHA256, "patch_size": 8, "feature_channels": 4,
    "inputs": ["photos"], "dtype": "float16", "amp": False, "seed": 0,
    "batches": {"views": [2], "samples_per_scene": 1}, "validation_views": [2],
}  # fmt: skip
NONSENSE = [None, True, -1, 0, 1e9, 2**70, "x", [], [[]], {}, {"a": None}, float("nan")]


def answer() -> dict[str, torch.Tensor]:
    return {
        "features": torch.rand(2, 4, 4), "depths": torch.rand(2, 16, 16) + 1,
        "confidences": torch.rand(2, 16, 16), "cam_from_world": torch.eye(4).repeat(2, 1, 1),
        "intrinsics": torch.eye(3).repeat(2, 1, 1),
    }  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A cache of one scene with one sample, written by hand."""
    index = {
        "format": "instok3d-features-1", "settings": SETTINGS,
        "training": ["room"], "held_out": [],
    }  # fmt: skip
    (tmp_path / "cache" / "scenes").mkdir(parents=True)
    (tmp_path / "cache" / "features.json").write_text(json.dumps(index))
    named = {f"2/0/photos/{name}": value for name, value in answer().items()}
    save_file(named, tmp_path / "cache" / "scenes" / "room.safetensors")
    return tmp_path / "cache"


def sample() -> Sample:
    images = torch.rand(1, 2, 3, 16, 16)
    empty = torch.zeros(1, 2, 16, 16, dtype=torch.long)
    views = Views(images)
    return Sample(views, views, empty, empty, ("room",), keys=("room/2/0",))


def read(folder: Path) -> None:
    FeatureCache(folder).geometry(sample(), given=False, intrinsics=False)


def check_message(reader: Callable[[Path], object], folder: Path, named: str) -> None:
    """Other errors than these two go through."""
    message = ""
    try:
        reader(folder)
    except (ValueError, KeyError) as error:
        message = str(error)
    assert not message or named in message
    assert "\n" not in message


def test_the_whole_cache_is_read(folder: Path):
    read(folder)


@pytest.mark.parametrize("key", [*SETTINGS, "training", "held_out", "settings"])
def test_an_index_of_other_kinds_is_refused_by_name(folder: Path, key: str):
    whole = json.loads((folder / "features.json").read_text())
    for value in [*NONSENSE, "missing"]:
        index = json.loads(json.dumps(whole))
        place = index["settings"] if key in SETTINGS else index
        if value == place[key] or (key in ("seed", "dtype", "amp", "backbone", "inputs")
                                   and type(value) is type(place[key])):  # fmt: skip
            continue
        if value == "missing":
            del place[key]
        else:
            place[key] = value
        (folder / "features.json").write_text(json.dumps(index))
        if key in ("training", "held_out", "validation_views") and value == []:
            continue
        with pytest.raises(ValueError, match=r"features\.json"):
            FeatureCache(folder)


def test_any_bytes_of_an_index_are_refused_or_read(folder: Path):
    chance = random.Random(0)
    whole = (folder / "features.json").read_bytes()
    for _ in range(200):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 3)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        if chance.random() < 0.3:
            del data[chance.randrange(len(data)) :]
        (folder / "features.json").write_bytes(data)
        check_message(FeatureCache, folder, "features.json")


def test_any_bytes_of_a_scene_are_refused_or_read(folder: Path):
    chance = random.Random(1)
    file = folder / "scenes" / "room.safetensors"
    whole = file.read_bytes()
    for turn in range(80):
        data = bytearray(whole)
        reach = 700 if turn % 2 else len(data)
        for _ in range(chance.randint(1, 3)):
            data[chance.randrange(reach)] = chance.randrange(256)
        if chance.random() < 0.3:
            del data[chance.randrange(len(data)) :]
        file.write_bytes(data)
        check_message(read, folder, "cache")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"depths": None}, "lacks depths"),
        ({"confidences": torch.ones(2, 8, 16)}, "confidences of the shape"),
        ({"features": torch.ones(2, 3, 4)}, "features of the shape"),
        ({"features": torch.full((2, 4, 4), torch.nan)}, "not finite"),
        ({"depths": torch.full((2, 16, 16), torch.inf)}, "not finite"),
        ({"intrinsics": torch.eye(3)[None]}, "intrinsics of the shape"),
        ({"cam_from_world": torch.eye(3).repeat(2, 1, 1)}, "cam_from_world of the shape"),
        ({"depths": torch.ones(2, 16, 16, dtype=torch.long)}, "not finite"),
        ({"pointmaps": torch.ones(2, 16, 16)}, "pointmaps of the shape"),
        ({"other": torch.ones(1)}, "other of the shape"),
        ({"depths": torch.full((2, 16, 16), -2.0)}, "depths below 0"),
        ({"confidences": torch.full((2, 16, 16), -1.0)}, "confidences below 0"),
        ({"cam_from_world": 2 * torch.eye(4).repeat(2, 1, 1)}, "view 0 has a pose whose last row"),
        (
            {"cam_from_world": torch.diag(torch.tensor([3.0, 1, 1, 1])).repeat(2, 1, 1)},
            "view 0 has a pose whose rotation is not orthonormal",
        ),
        (
            {"cam_from_world": torch.diag(torch.tensor([-1.0, 1, 1, 1])).repeat(2, 1, 1)},
            "view 0 has a mirrored camera",
        ),
        (
            {"intrinsics": torch.diag(torch.tensor([-1.0, 1, 1])).repeat(2, 1, 1)},
            "view 0 has the focal length -1",
        ),
    ],
)
def test_features_that_no_backbone_gives_are_named(folder: Path, change: dict, said: str):
    file = folder / "scenes" / "room.safetensors"
    tensors = load_file(file)
    for name, value in change.items():
        tensors.pop(f"2/0/photos/{name}", None)
        if value is not None:
            tensors[f"2/0/photos/{name}"] = value
    save_file(tensors, file)
    with pytest.raises(ValueError, match=rf"room\.safetensors, sample room/2/0, .*{said}"):
        read(folder)


def test_tensors_without_a_sample_are_no_features(folder: Path):
    file = folder / "scenes" / "room.safetensors"
    save_file({"alone": torch.ones(1)}, file)
    with pytest.raises(KeyError, match="has no features of sample"):
        read(folder)
    shutil.rmtree(folder / "scenes")
    with pytest.raises(KeyError, match="no features of scene room"):
        read(folder)


def test_pointmaps_of_the_right_shape_are_taken():
    check_answer(answer() | {"pointmaps": torch.ones(2, 16, 16, 3)}, SETTINGS, 2, "file")
