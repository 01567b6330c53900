"""The networks against those of transformers with the same weights under other names."""

import re

import pytest
import torch

from instok3d.semantics.teachers.lseg.image_network import Pretrained, Scratch
from instok3d.semantics.teachers.lseg.text_network import TextEncoder
from tiny_lseg import IMAGE, TEXT, random_


def renamed(state: dict[str, torch.Tensor], rules: list[tuple[str, str]]):
    """The state dict under other names."""
    found = {}
    for name, value in state.items():
        for pattern, replacement in rules:
            name = re.sub(pattern, replacement, name)
        found[name] = value
    return found


def test_the_text_encoder_is_that_of_clip():
    transformers = pytest.importorskip("transformers")
    own = random_(TextEncoder(TEXT))
    config = transformers.CLIPTextConfig(
        vocab_size=TEXT.vocabulary, hidden_size=TEXT.width, intermediate_size=4 * TEXT.width,
        projection_dim=TEXT.features, num_hidden_layers=TEXT.layers, num_attention_heads=1,
        max_position_embeddings=TEXT.longest, eos_token_id=TEXT.vocabulary - 1,
    )  # fmt: skip
    twin = transformers.CLIPTextModelWithProjection(config).eval()
    state = own.state_dict()
    for name in [*state]:
        if ".attn.in_proj_" in name:
            for part, value in zip("qkv", state.pop(name).chunk(3), strict=True):
                state[name.replace("attn.in_proj_", f"self_attn.{part}_proj.")] = value
    state["text_projection.weight"] = state.pop("text_projection").T
    theirs = renamed(
        state,
        [
            (r"^token_embedding", "text_model.embeddings.token_embedding"),
            (r"^positional_embedding", "text_model.embeddings.position_embedding.weight"),
            (r"^transformer.resblocks", "text_model.encoder.layers"),
            (r"attn.out_proj", "self_attn.out_proj"),
            (r"self_self_attn", "self_attn"),
            (r"mlp.c_fc", "mlp.fc1"),
            (r"mlp.c_proj", "mlp.fc2"),
            (r"\.ln_([12])", r".layer_norm\1"),
            (r"^ln_final", "text_model.final_layer_norm"),
        ],
    )
    twin.load_state_dict(theirs)
    ids = torch.tensor([[518, 3, 4, 519, 0], [518, 7, 519, 0, 0]])
    with torch.no_grad():
        torch.testing.assert_close(own(ids), twin(ids).text_embeds, rtol=1e-4, atol=1e-5)


def test_the_image_network_is_dpt():
    transformers = pytest.importorskip("transformers")
    own_tokens, own_maps = random_(Pretrained(IMAGE)), random_(Scratch(IMAGE), seed=1)
    config = transformers.DPTConfig(
        hidden_size=IMAGE.width, num_hidden_layers=IMAGE.depth, num_attention_heads=1,
        intermediate_size=4 * IMAGE.width, image_size=16 * IMAGE.grid, patch_size=16,
        layer_norm_eps=1e-6, backbone_out_indices=[0, 1, 2, 3], readout_type="project",
        neck_hidden_sizes=[*IMAGE.scale_channels], fusion_hidden_size=IMAGE.fused,
        use_batch_norm_in_fusion_residual=True, use_auxiliary_head=False,
    )  # fmt: skip
    twin = transformers.DPTForSemanticSegmentation(config).eval()
    state = own_tokens.state_dict() | own_maps.state_dict()
    for name in [*state]:
        if ".attn.qkv." in name:
            for part, value in zip(
                ("query", "key", "value"), state.pop(name).chunk(3), strict=True
            ):
                state[name.replace("attn.qkv", f"attention.attention.{part}")] = value
        elif "num_batches_tracked" in name:
            del state[name]
    del state["head1.weight"], state["head1.bias"]
    theirs = renamed(
        state,
        [
            (r"^model.cls_token", "dpt.embeddings.cls_token"),
            (r"^model.pos_embed", "dpt.embeddings.position_embeddings"),
            (r"^model.patch_embed.proj", "dpt.embeddings.patch_embeddings.projection"),
            (r"^model.blocks", "dpt.encoder.layer"),
            (r"attn.proj", "attention.output.dense"),
            (r"norm1", "layernorm_before"),
            (r"norm2", "layernorm_after"),
            (r"mlp.fc1", "intermediate.dense"),
            (r"mlp.fc2", "output.dense"),
            (r"^act_postprocess(\d).0.project", r"neck.reassemble_stage.readout_projects.<\1>"),
            (r"^act_postprocess(\d).3", r"neck.reassemble_stage.layers.<\1>.projection"),
            (r"^act_postprocess(\d).4", r"neck.reassemble_stage.layers.<\1>.resize"),
            (r"^layer(\d)_rn", r"neck.convs.<\1>"),
            (r"<(\d)>", lambda found: str(int(found[1]) - 1)),
            (r"^refinenet(\d)", lambda f: f"neck.fusion_stage.layers.{4 - int(f[1])}"),
            (r"resConfUnit", "residual_layer"),
            (r"out_conv", "projection"),
            (r"\.conv([12])", r".convolution\1"),
            (r"\.bn([12])", r".batch_norm\1"),
        ],
    )
    report = twin.load_state_dict(theirs, strict=False)
    assert not report.unexpected_keys
    left = [name for name in report.missing_keys if "num_batches_tracked" not in name]
    assert all(name.startswith(("head.", "dpt.layernorm.", "neck.fusion_stage.layers.0.residual_"))
               for name in left), left  # fmt: skip

    images = torch.rand(2, 3, 64, 96, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        hidden = twin.dpt(images, output_hidden_states=True).hidden_states[1:]
        fused = twin.neck([*hidden], 4, 6)[-1]
        wanted = torch.nn.functional.conv2d(fused, own_maps.head1.weight, own_maps.head1.bias)
        found = own_maps(own_tokens(images))
    assert found.shape == (2, IMAGE.features, 32, 48)
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-5)
