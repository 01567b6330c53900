"""A damaged model file is read, or refused in one line before memory for it is taken."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from instok3d.backbones import registry
from instok3d.backbones.cost import Outline
from instok3d.model.files import load_model, read_card, read_sizes, read_unit, save_model
from instok3d.model.tokenizer import Tokenizer
from made_model import SIZES, made_model
from mutations import limits, of_safetensors, survive
from plane_backbone import PLANE, PlaneBackbone, PlaneConfig


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return made_model(tmp_path / "model.safetensors")


def contents(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    with safe_open(path, framework="pt") as stream:
        names = list(stream.keys())
        return {name: stream.get_tensor(name) for name in names}, stream.metadata()


def test_any_damage(path: Path):
    def read() -> None:
        read_card(path)
        read_unit(path)
        model = load_model(path)
        assert all(value.isfinite().all() for value in model.state_dict().values())

    assert survive(path, read, of_safetensors, 120)
    load_model(path)


@pytest.mark.parametrize("config", ["backbone_config", "tokenizer_config"])
@pytest.mark.parametrize("value", [-1, 0, 2**20, 10**30, "32"])
def test_no_value_of_a_size_takes_memory_or_time(path: Path, config: str, value: object):
    state, metadata = contents(path)
    sizes = json.loads(metadata[config])
    for name in sizes:
        save_file(state, path, metadata | {config: json.dumps({**sizes, name: value})})
        told = ""
        try:
            with limits():
                load_model(path)
        except ValueError as error:
            told = str(error)
        assert told.startswith(str(path)) or value in (0, 2**20), name
        assert "\n" not in told, name


REASONS = {
    "its width of NanoConfig: '32' is no whole number": ("backbone_config", "width", "32"),
    "layers of NanoConfig: -1 is no whole number": ("backbone_config", "layers", -1),
    "ask for more than": ("backbone_config", "layers", 2**20),
    "has the shape": ("backbone_config", "width", 2**20),
    "neither true nor false": ("tokenizer_config", "normalize_heads", 2),
    "'x' is no number": ("backbone_config", "typical_field_of_view_rad", "x"),
}


@pytest.mark.parametrize("reason", REASONS)
def test_a_size_that_cannot_be_is_told(path: Path, reason: str):
    config, name, value = REASONS[reason]
    state, metadata = contents(path)
    sizes = json.loads(metadata[config]) | {name: value}
    save_file(state, path, metadata | {config: json.dumps(sizes)})
    for read in (load_model, read_sizes):
        with limits(), pytest.raises(ValueError, match=rf"model\.safetensors is .*{reason}"):
            read(path)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_weight_that_is_not_finite_is_told(path: Path, value: float):
    state, metadata = contents(path)
    name = min(state)
    state[name].view(-1)[0] = value
    save_file(state, path, metadata)
    with pytest.raises(ValueError, match=rf"model\.safetensors .*weight {name} is not finite"):
        load_model(path)


def test_weights_of_whole_numbers_are_told(path: Path):
    state, metadata = contents(path)
    name = min(state)
    save_file(state | {name: state[name].to(torch.int8)}, path, metadata)
    with pytest.raises(ValueError, match=rf"weight {name} holds I8, wanted torch.float32"):
        load_model(path)


def test_a_header_longer_than_the_file_is_told(path: Path):
    for length in (2**20, 2**40, 2**64 - 1):
        path.write_bytes(length.to_bytes(8, "little") + path.read_bytes()[8:])
        with pytest.raises(ValueError, match=r"model\.safetensors is not a whole safetensors"):
            load_model(path)


def test_an_empty_file_is_told(path: Path):
    path.write_bytes(b"")
    with pytest.raises(ValueError, match=r"model\.safetensors is not a whole safetensors"):
        load_model(path)


def test_a_file_of_a_backbone_that_cannot_be_built_on_paper_is_compared_too(
    tmp_path: Path, plane: str, monkeypatch: pytest.MonkeyPatch
):
    config = PlaneConfig()
    numbers = sum(value.numel() for value in PlaneBackbone(config).parameters())

    def outline(config: PlaneConfig) -> Outline:
        return Outline(numbers, config.patch_size, config.channels)

    monkeypatch.setitem(registry._REGISTERED, plane, replace(PLANE, outline=outline))
    path = tmp_path / "model.safetensors"
    save_model(Tokenizer(PlaneBackbone(config), SIZES), path, card={})
    load_model(path)
    state, metadata = contents(path)
    own = next(name for name in state if name.startswith("backbone."))
    other = next(name for name in state if not name.startswith("backbone."))
    damages = {
        f"its backbone has .* numbers, wanted {numbers}": {own: torch.zeros(1)},
        "has the shape": {other: torch.zeros(1, 2, 3, 4, 5)},
        "has the unknown weight x": {"x": torch.zeros(1)},
        "size mismatch": {own: torch.zeros(10 * numbers)},
    }
    for reason, change in damages.items():
        save_file(state | change, path, metadata)
        with (
            limits(),
            pytest.raises(ValueError, match=rf"model\.safetensors is damaged .*{reason}"),
        ):
            load_model(path)
    for sizes in ({"patch_size": 2**20}, {"channels": 2**20}):
        changed = json.dumps(json.loads(metadata["backbone_config"]) | sizes)
        save_file(state, path, metadata | {"backbone_config": changed})
        with limits(), pytest.raises(ValueError, match=r"model\.safetensors is damaged"):
            load_model(path)
