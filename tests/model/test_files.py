import json
from dataclasses import asdict, fields

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from instok3d.backbones.registry import OWN
from instok3d.model import files
from instok3d.model.files import (
    MissingWeightsError,
    load_model,
    read_card,
    read_sizes,
    save_model,
)
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.types import Views
from made_model import made_model
from plane_backbone import PlaneBackbone, PlaneConfig


@pytest.fixture
def model(plane) -> Tokenizer:
    torch.manual_seed(0)
    head = GaussianHeadConfig(gaussians_per_anchor=4, sh_degree=2)
    config = TokenizerConfig(
        width=32, num_anchors=8, num_groups=3, anchor_layers=1, group_layers=1,
        head_size=16, gaussian_head=head,
    )  # fmt: skip
    return Tokenizer(PlaneBackbone(PlaneConfig(channels=8)), config).eval()


def rewritten(path, **changes):
    """The same weights with other metadata."""
    with safe_open(path, framework="pt") as stream:
        metadata = {**stream.metadata(), **changes}
        state = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118
    save_file(state, path, metadata=metadata)


def test_a_saved_model_comes_back_the_same(model, tmp_path, rng):
    path = tmp_path / "model.safetensors"
    save_model(model, path, card={"rooms": 2000}, half=False)
    again = load_model(path)
    assert again.config == model.config
    assert again.backbone.config == model.backbone.config
    assert not again.training
    views = Views(torch.rand(1, 2, 3, 16, 16, generator=rng))
    torch.testing.assert_close(again(views).gaussians.means, model(views).gaussians.means)
    assert read_card(path) == {"rooms": 2000}


def test_loading_draws_no_random_weights_only_to_replace_them(model, tmp_path):
    save_model(model, tmp_path / "model.safetensors", card={}, half=False)
    before = torch.random.get_rng_state()
    again = load_model(tmp_path / "model.safetensors")
    assert torch.equal(torch.random.get_rng_state(), before)
    for ours, theirs in ((again.state_dict(), model.state_dict()),
                         (dict(again.named_buffers()), dict(model.named_buffers()))):  # fmt: skip
        assert ours.keys() == theirs.keys()
        assert all(torch.equal(ours[name], theirs[name]) for name in ours)


def test_half_precision_halves_the_file_and_hardly_moves_the_weights(model, tmp_path):
    save_model(model, tmp_path / "whole", card={}, half=False)
    save_model(model, tmp_path / "half", card={})
    sizes = [(tmp_path / name).stat().st_size for name in ("half", "whole")]
    assert sizes[0] < 0.6 * sizes[1]
    again = load_model(tmp_path / "half").state_dict()
    for name, value in model.state_dict().items():
        assert again[name].dtype == torch.float32
        torch.testing.assert_close(again[name], value, rtol=1e-3, atol=1e-6)


def test_missing_files_say_what_to_do(monkeypatch, tmp_path):
    with pytest.raises(MissingWeightsError, match=r"no model file .*nowhere"):
        load_model(tmp_path / "nowhere.safetensors")
    monkeypatch.setattr(files, "DEFAULT_MODEL", tmp_path / "default.safetensors")
    with pytest.raises(FileNotFoundError, match="default model is not installed"):
        load_model()


def test_a_cut_file_is_named(model, tmp_path):
    path = tmp_path / "model.safetensors"
    save_model(model, path, card={})
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"model\.safetensors is not a whole safetensors file"):
        load_model(path)


def test_another_kind_of_file_is_named(tmp_path):
    path = tmp_path / "other.safetensors"
    save_file({"x": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match="not an InsTok3D model: its format is None"):
        load_model(path)


def test_unknown_backbones_and_sizes_are_named(model, tmp_path):
    path = tmp_path / "model.safetensors"
    save_model(model, path, card={})
    rewritten(path, backbone="giant")
    with pytest.raises(ValueError, match=r"needs the backbone 'giant'; there are .*plane, vggt"):
        load_model(path)
    rewritten(path, backbone="plane", backbone_config=json.dumps({"patch_size": 8, "wings": 2}))
    with pytest.raises(ValueError, match="does not know: wings of PlaneConfig"):
        load_model(path)
    rewritten(path, backbone_config=json.dumps({"patch_size": 8}))
    with pytest.raises(ValueError, match=r"lacks sizes.*: channels of PlaneConfig"):
        load_model(path)


def test_weights_that_do_not_fit_are_named(model, tmp_path):
    path = tmp_path / "model.safetensors"
    save_model(model, path, card={})
    rewritten(path, backbone_config=json.dumps({"patch_size": 8, "channels": 9}))
    with pytest.raises(ValueError, match="do not fit its own sizes"):
        load_model(path)


def test_a_weight_that_is_not_finite_is_never_written(model, tmp_path):
    with torch.no_grad():
        model.assign.log_temperature.fill_(1e6)  # beyond float16
    with pytest.raises(ValueError, match=r"log_temperature is not finite in float16"):
        save_model(model, tmp_path / "model.safetensors", card={})
    assert list(tmp_path.iterdir()) == []


def test_a_file_from_before_a_size_was_there_means_what_it_was_made_with(model, tmp_path):
    path = tmp_path / "model.safetensors"
    save_model(model, path, card={})
    sizes = asdict(model.config)
    for name in ("normalize_scale", "pad_duplicates", "project_assignment"):
        del sizes[name]
    rewritten(path, tokenizer_config=json.dumps(sizes))
    assert load_model(path).config == model.config
    del sizes["width"]
    rewritten(path, tokenizer_config=json.dumps(sizes))
    with pytest.raises(ValueError, match=r"lacks sizes.*: width of TokenizerConfig"):
        load_model(path)


def test_what_older_files_mean_is_said_of_sizes_that_there_are():
    kinds = {kind.__name__: kind for kind in (TokenizerConfig, GaussianHeadConfig)}
    for name, sizes in files.ADDED_LATER.items():
        assert set(sizes) <= {field.name for field in fields(kinds[name])}
    for load in OWN.values():
        kind = load()
        assert set(kind.added_later) <= {field.name for field in fields(kind.config)}


def test_a_file_from_before_the_nano_backbone_refined_depth_has_none_of_it(tmp_path):
    path = made_model(tmp_path / "model.safetensors")
    with safe_open(path, framework="pt") as stream:
        metadata = stream.metadata()
        names = [name for name in stream.keys() if ".refinement." not in name]  # noqa: SIM118
        state = {name: stream.get_tensor(name) for name in names}
    sizes = json.loads(metadata["backbone_config"])
    del sizes["refinement_layers"]
    save_file(state, path, {**metadata, "backbone_config": json.dumps(sizes)})
    backbone, _ = read_sizes(path)
    assert backbone.refinement_layers == 0
