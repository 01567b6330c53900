"""SAM 2 of a million random weights, as a folder that transformers reads."""

from pathlib import Path
from typing import Any

import torch

SIDE = 64


def write_tiny_sam2(folder: Path, seed: int = 0) -> Path:
    """Write config.json and model.safetensors; the caller has skipped without transformers."""
    from transformers import Sam2VideoModel

    model = Sam2VideoModel(tiny_config())
    rng = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(0.1 * torch.randn(parameter.shape, generator=rng))
        # Score of "the thing is seen": always, else random weights see nothing at all.
        model.mask_decoder.pred_obj_score_head.proj_out.bias.fill_(3.0)
    model.save_pretrained(folder)
    return folder


def tiny_config() -> Any:
    from transformers import Sam2VideoConfig

    # The code fixes 64 channels of memory and wants features that are a multiple of them; the
    # first block of a stage must not have global attention.
    wide, cells = 128, SIDE // 16
    backbone = {
        "model_type": "sam2_hiera_det_model", "hidden_size": 8, "num_attention_heads": 1,
        "image_size": [SIDE, SIDE], "blocks_per_stage": [1, 1, 2, 1],
        "embed_dim_per_stage": [8, 16, 32, 64], "num_attention_heads_per_stage": [1, 1, 2, 2],
        "window_size_per_stage": [4, 4, 4, 2], "global_attention_blocks": [3],
        "window_positional_embedding_background_size": [4, 4],
    }  # fmt: skip
    return Sam2VideoConfig(
        vision_config={
            "model_type": "sam2_vision_model", "backbone_config": backbone,
            "backbone_channel_list": [64, 32, 16, 8], "fpn_hidden_size": wide,
            "backbone_feature_sizes": [[4 * cells] * 2, [2 * cells] * 2, [cells] * 2],
        },
        prompt_encoder_config={
            "hidden_size": wide, "image_size": SIDE, "patch_size": 16, "mask_input_channels": 4
        },
        mask_decoder_config={
            "hidden_size": wide, "mlp_dim": 32, "num_attention_heads": 2,
            "iou_head_hidden_dim": 16,
        },
        image_size=SIDE, memory_attention_hidden_size=wide, memory_attention_num_layers=1,
        memory_attention_feed_forward_hidden_size=32,
        memory_attention_rope_feat_sizes=[cells, cells], memory_encoder_hidden_size=wide,
        memory_encoder_output_channels=64, mask_downsampler_embed_dim=wide,
        memory_fuser_embed_dim=wide, memory_fuser_intermediate_dim=32,
        memory_fuser_num_layers=1, num_maskmem=3, max_object_pointers_in_encoder=4,
    )  # fmt: skip
