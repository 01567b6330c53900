"""`train cache` replaces what is damaged in a cache, and keeps what is sound."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from fake_rooms import FakeRooms
from instok3d.data.batches import BatchConfig
from instok3d.training.cache.features import FeatureCache
from instok3d.training.cache.settings import check_cache
from instok3d.training.cache.writing import FilledCache, fill_cache
from instok3d.training.config import preset
from instok3d.training.stages.tokenizer import TokenizerStageConfig
from mutations import of_safetensors, survive
from plane_backbone import PlaneBackbone, PlaneConfig

ROOMS = FakeRooms(2, size=16)
CONFIG = replace(
    preset("nano-tokenizer"),
    stage=TokenizerStageConfig(backbone=PlaneConfig(), given_probability=0.5),
    batches=BatchConfig(batch_size=1, views=(2,), samples_per_scene=1),
    holdout=1,
    validation_views=(2,),
    amp=False,
)


def fill(folder: Path) -> FilledCache:
    torch.manual_seed(0)
    return fill_cache(CONFIG, ROOMS, folder, PlaneBackbone(PlaneConfig()).state_dict())


@pytest.fixture
def folder(tmp_path: Path, plane: str) -> Path:
    assert plane == "plane"
    fill(tmp_path)
    return tmp_path


def rewrite(file: Path, tensors: dict[str, torch.Tensor], **metadata: str) -> None:
    with safe_open(file, framework="pt") as stream:
        before = stream.metadata()
    save_file(tensors, file, before | metadata)


CHANGES = {
    "features": ("features that are not finite", lambda value: value.fill_(torch.nan)),
    "depths": ("depths below 0", lambda value: -value),
    "confidences": ("confidences that are not finite", lambda value: value.fill_(torch.inf)),
    "cam_from_world": ("rotation is not orthonormal", lambda value: value * 0.5 + 0.5),
    "intrinsics": ("intrinsics of the shape", lambda value: value[:1].clone()),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_scene_file_with_values_that_cannot_be_is_made_anew(folder: Path, name: str):
    file = folder / "scenes" / "1.safetensors"
    whole, tensors = file.read_bytes(), load_file(file)
    last = max(key for key in tensors if key.endswith(f"/{name}"))
    tensors[last] = CHANGES[name][1](tensors[last])
    rewrite(file, tensors)
    with pytest.warns(UserWarning, match=r"1\.safetensors, sample 1/2/0.*: it is made anew"):
        filled = fill(folder)
    assert filled.made == 1
    assert file.read_bytes() == whole
    assert fill(folder).made == 0


def test_a_scene_file_without_a_part_of_an_answer_is_made_anew(folder: Path):
    file = folder / "scenes" / "1.safetensors"
    whole, tensors = file.read_bytes(), load_file(file)
    rewrite(file, {key: value for key, value in tensors.items() if "photos/depths" not in key})
    with pytest.warns(UserWarning, match=r"1\.safetensors.* lacks depths.*: it is made anew"):
        assert fill(folder).made == 1
    assert file.read_bytes() == whole


def test_any_damage_of_a_scene_file_is_mended_or_refused(folder: Path):
    file = folder / "scenes" / "1.safetensors"

    def read() -> None:
        fill(folder)
        FeatureCache(folder).check_scene("1")

    survive(file, read, of_safetensors, 20)
    assert fill(folder).made == 0


def test_damaged_weights_of_the_backbone_are_written_again(folder: Path):
    file = folder / "backbone.safetensors"
    whole = file.read_bytes()
    changed = {key: value + 1 for key, value in load_file(file).items()}
    save_file(changed, file)
    for damage in (file.read_bytes(), whole[:100], b""):
        file.write_bytes(damage)
        with pytest.warns(UserWarning, match=r"backbone\.safetensors .*: it is written again"):
            assert fill(folder).made == 0
        assert file.read_bytes() == whole


def test_damaged_weights_of_the_backbone_are_refused(folder: Path):
    file = folder / "backbone.safetensors"
    read = lambda: FeatureCache(folder).backbone_weights()  # noqa: E731
    assert survive(file, read, of_safetensors, 100)
    file.unlink()
    with pytest.raises(ValueError, match=r"backbone\.safetensors is missing; run .* again"):
        read()


def test_a_scene_file_of_other_settings_is_refused_before_training(folder: Path):
    file = folder / "scenes" / "1.safetensors"
    check_cache(FeatureCache(folder), CONFIG, ROOMS)
    rewrite(file, load_file(file), settings="0" * 64)
    with pytest.raises(ValueError, match=r"1\.safetensors was made with other settings than feat"):
        check_cache(FeatureCache(folder), CONFIG, ROOMS)
