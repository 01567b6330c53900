import base64
from dataclasses import replace

import numpy as np
import pytest
import torch

from instok3d.webpage.packing import PackedGaussians, pack
from made_scene import made_scene, made_tokens


def unpacked(packed: PackedGaussians) -> dict[str, np.ndarray]:
    """As gaussians.js reads it."""
    data, offset, arrays = base64.b64decode(packed.base64), 0, {}
    kinds = {"float32": "<f4", "float16": "<f2", "int16": "<i2", "int8": "i1"}
    for array in packed.layout:
        values = np.frombuffer(data, kinds[array.type], array.length, offset)
        arrays[array.name] = values.astype(np.float64) * array.scale
        offset += -(-values.nbytes // 4) * 4
    assert offset == len(data)
    return arrays


@pytest.mark.parametrize("coefficients", [1, 4])
def test_what_is_packed_comes_back_within_the_stated_steps(coefficients: int):
    gaussians = made_scene(made_tokens()).gaussians
    packed = pack(gaussians, coefficients)
    back, sh = unpacked(packed), gaussians.sh[:, :coefficients].numpy()
    assert (back["means"] == gaussians.means.numpy().ravel()).all()
    assert np.allclose(back["scales"], gaussians.scales.numpy().ravel(), rtol=0)
    assert np.abs(back["quats"] - gaussians.quats.numpy().ravel()).max() <= 1 / 32767
    assert np.abs(back["opacities"] - gaussians.opacities.numpy()).max() <= 2**-11
    assert np.abs(back["sh_constant"] - sh[:, 0].ravel()).max() <= 2**-10
    others = sh[:, 1:].ravel()
    step = np.abs(others).max(initial=0) / 127
    assert np.abs(back["sh_others"] - others).max(initial=0) <= 0.51 * step
    assert packed.coefficients == coefficients


def test_no_gaussians_are_no_bytes():
    gaussians = made_scene(made_tokens()).gaussians.rows(slice(0, 0))
    assert pack(gaussians, 4).base64 == ""


def test_colours_beyond_half_precision_are_cut():
    gaussians = made_scene(made_tokens()).gaussians
    bright = replace(gaussians, sh=torch.full_like(gaussians.sh, 1e6))
    assert np.isfinite(unpacked(pack(bright, 4))["sh_constant"]).all()
