"""Files of weights that others made are read, or refused in one sentence that names the file."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from instok3d.backbones.vggt import load_vggt_weights
from instok3d.objectives.lpips import Lpips, load_lpips
from instok3d.training.checkpoint import read_weights
from instok3d.weights.reading import read_weights_file
from mutations import limits, of_safetensors, survive
from tiny_vggt import TINY_VGGT, tiny_vggt

Made = tuple[dict[str, torch.Tensor], dict[str, str], Callable[[Path], object]]


def lpips() -> Made:
    state = Lpips("alexnet").state_dict()
    return state, {"lpips_trunk": "alexnet"}, load_lpips


def vggt() -> Made:
    return tiny_vggt().state_dict(), {}, lambda path: load_vggt_weights(path, TINY_VGGT)


def depth_anything_3() -> Made:
    pytest.importorskip("depth_anything_3", reason="the package depth-anything-3 is not installed")
    from instok3d.backbones import depth_anything3

    config = depth_anything3.DepthAnything3Config(size="tiny")
    state = depth_anything3.DepthAnything3Backbone(config).net.state_dict()
    published = {f"model.{name}": value.clone() for name, value in state.items()}  # some share
    return published, {}, lambda p: depth_anything3.load_depth_anything3_weights(p, config)


def first_weights() -> Made:
    return {"w": torch.ones(3), "b": torch.zeros(1)}, {}, read_weights


READERS = [lpips, vggt, depth_anything_3, first_weights]


def refusal(path: Path, read: Callable[[Path], object]) -> str:
    with limits(), pytest.raises(ValueError, match=path.name) as error:
        read(path)
    message = str(error.value)
    assert "\n" not in message
    assert len(message) < 600
    return message


@pytest.mark.parametrize("made", READERS)
def test_weights_that_cannot_be(tmp_path: Path, made: Callable[[], Made]):
    state, metadata, read = made()
    path = tmp_path / "made.safetensors"
    save_file(state, path, metadata)
    read(path)
    whole, name = path.read_bytes(), max(state)
    for value in (torch.nan, torch.inf):
        bad = state[name].clone().float()
        bad.view(-1)[-1] = value
        save_file(state | {name: bad}, path, metadata)
        assert f"the weight {name}, which is not finite" in refusal(path, read)
    for data in (
        b"", b"{}", whole[:7], whole[: len(whole) // 2], whole[:-1], whole + b"\0", b"\xff" * 5000,
        (2**40).to_bytes(8, "little") + whole[8:], "é".encode("latin-1") * 100,
    ):  # fmt: skip
        path.write_bytes(data)
        assert "is not a whole safetensors file" in refusal(path, read)


@pytest.mark.parametrize("made", READERS[:-1])
def test_weights_of_another_network(tmp_path: Path, made: Callable[[], Made]):
    state, metadata, read = made()
    path, name = tmp_path / "made.safetensors", max(state)
    others = (
        {key: value for key, value in state.items() if key != name},
        state | {f"{name}x": torch.ones(1)},
        state | {name: torch.ones(1, 2, 3, 4, 5)},
        {f"other.{key}": value for key, value in state.items()},
        {"x": torch.ones(1)},
    )
    for other in others:
        save_file(other, path, metadata)
        refusal(path, read)


@pytest.mark.parametrize("made", READERS)
def test_any_damage(tmp_path: Path, made: Callable[[], Made]):
    state, metadata, read = made()
    path = tmp_path / "made.safetensors"
    save_file(state, path, metadata)
    assert survive(path, lambda: read(path), of_safetensors, 25)


def test_a_shape_of_terabytes_takes_no_memory(tmp_path: Path):
    path = tmp_path / "made.safetensors"
    entry = {"dtype": "F32", "shape": [2**20, 2**20], "data_offsets": [0, 2**42]}
    text = json.dumps({"w": entry}).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text)
    refusal(path, lambda p: read_weights_file(p, "fetch it again"))


def test_only_what_is_wanted_is_read(tmp_path: Path):
    path = tmp_path / "made.safetensors"
    save_file({"a": torch.ones(1).half(), "b": torch.tensor([torch.nan])}, path, {"k": "v"})
    weights, metadata = read_weights_file(path, "", wanted=lambda name: name == "a")
    assert weights.keys() == {"a"}
    assert weights["a"].dtype == torch.float32
    assert metadata == {"k": "v"}
    save_file({}, path)
    assert read_weights_file(path, "") == ({}, {})
