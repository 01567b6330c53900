"""The paper's tokenizer with random weights: shapes and parameter counts of every part."""

import re
from functools import cache
from pathlib import Path

import pytest
import torch
from torch import nn

from instok3d.model.tokenizer import PAPER, Tokenizer
from instok3d.types import Views
from plane_backbone import PlaneBackbone, PlaneConfig

PAGE = Path(__file__).resolve().parents[2] / "docs" / "paper_map.md"


@cache
def paper_tokenizer() -> Tokenizer:
    """With a stand-in for VGGT: 2,048 channels, patches of 16 pixels."""
    torch.manual_seed(0)
    return Tokenizer(PlaneBackbone(PlaneConfig(patch_size=16, channels=2048)), PAPER).eval()


def millions(*modules: nn.Module) -> float:
    return sum(p.numel() for module in modules for p in module.parameters()) / 1e6


@pytest.mark.parametrize(("views", "patches"), [(2, 512), (8, 2048)])
def test_shapes_of_the_papers_sizes(rng, views, patches):
    # 256 / 16 = 16 patches a side, 256 a view; K = 1024 anchors or one for each patch; 32
    # Gaussians each, 9 harmonics; 100 groups and the void.
    model = paper_tokenizer()
    anchors = min(patches, 1024)
    images = torch.rand(1, views, 3, 256, 256, generator=rng)
    seen = []
    hook = model.fuse.register_forward_hook(lambda module, given, context: seen.append(context))
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        groups = model(Views(images))
    hook.remove()
    (context,) = seen
    assert groups.geometry.features.shape == (1, views, 256, 2048)
    assert groups.geometry.pointmaps.shape == (1, views, 256, 256, 3)
    assert context.tokens.shape == (1, patches, 1024)
    assert context.positions.shape == (1, patches, 3)
    assert context.scale.tolist() == [1.0]
    assert groups.anchors.positions.shape == (1, anchors, 3)
    assert len(set(groups.anchors.patches[0].tolist())) == anchors
    assert groups.anchors.tokens.shape == (1, anchors, 1024)
    assert groups.tokens.shape == (1, 100, 1024)
    assert groups.assignment.shape == (1, anchors, 101)
    gaussians = groups.gaussians
    assert gaussians.means.shape == gaussians.scales.shape == (1, 32 * anchors, 3)
    assert gaussians.quats.shape == (1, 32 * anchors, 4)
    assert gaussians.opacities.shape == (1, 32 * anchors)
    assert gaussians.sh.shape == (1, 32 * anchors, 9, 3)
    assert gaussians.anchor_index.shape == (1, 32 * anchors)
    for name in ("means", "scales", "quats", "opacities", "sh"):
        value = getattr(gaussians, name)
        assert value.dtype == torch.float32, name
        assert value.isfinite().all(), name
    torch.testing.assert_close(groups.assignment.sum(dim=-1), torch.ones(1, anchors))
    assert gaussians.scales.max() <= 0.3 + 1e-6
    offsets = gaussians.means - groups.anchors.positions.repeat_interleave(32, dim=1)
    assert offsets.abs().max() <= 0.1 + 1e-6


def test_sizes_that_the_paper_states():
    model = paper_tokenizer()
    # 3 offset + 3 scale + 4 rotation + 1 opacity + 27 harmonics = 38 numbers for each Gaussian
    assert model.gaussian_head.out.out_features == 32 * 38 == 1216
    assert len(model.anchor_decoder.decoder.layers) == 6
    assert len(model.group_decoder.decoder.layers) == 4
    assert model.group_decoder.queries.shape == (100, 1024)
    heads = 1024 // model.anchor_decoder.decoder.layers[0].cross_attention.head_size
    assert heads == 16
    # Hidden layers, which it does not state.
    assert model.place.position_embedding[0].out_features == 1024
    assert model.gaussian_head.hidden[0].out_features == 2048


def test_parameter_counts_are_those_of_the_page():
    model = paper_tokenizer()
    parts = {
        "context fusion": (model.fuse,),
        "anchor placement": (model.place,),
        "D_anchor": (model.anchor_decoder,),
        "D_group and its queries": (model.group_decoder,),
        "assignment": (model.assign,),
        "Gaussian head": (model.gaussian_head,),
    }
    text = PAGE.read_text()
    for name, modules in parts.items():
        assert f"| {name} | {millions(*modules):.3f} M |" in text
    own = sum(p.numel() for p in model.own_parameters())
    assert f"| tokenizer, all of it | {own / 1e6:.3f} M |" in text
    found = re.findall(r"has ([\d,]+) parameters of its own", text)
    assert [int(number.replace(",", "")) for number in found] == [own]


def test_a_decoder_layer_counted_by_hand():
    # Two norms of 2 x 1024; query 1024^2, key and value 2 x 1024^2, out 1024^2 + 1024;
    # MLP 1024 x 4096 + 4096 + 4096 x 1024 + 1024.
    attention = 4 * 1024**2 + 1024
    mlp = 2 * 1024 * 4096 + 4096 + 1024
    layer = paper_tokenizer().anchor_decoder.decoder.layers[0]
    assert sum(p.numel() for p in layer.parameters()) == 2 * 2 * 1024 + attention + mlp
