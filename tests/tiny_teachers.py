"""CLIP, SigLIP 2 and DINO of random weights, as folders that transformers reads."""

from pathlib import Path
from typing import Any

import torch

WORDS = ["[PAD]", "[BEGIN]", "[UNK]", "chair", "red", "table", "the", "[END]"]
"""[END] has the largest id, as CLIP's has."""
TOWER = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2,
         "num_attention_heads": 2}  # fmt: skip


def write_tiny_clip(folder: Path) -> Path:
    import transformers

    text = TOWER | {"vocab_size": len(WORDS), "max_position_embeddings": 8,
                    "eos_token_id": 7, "bos_token_id": 1, "pad_token_id": 0}  # fmt: skip
    vision = TOWER | {"image_size": 32, "patch_size": 8}
    config = transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=12)
    return _written(transformers.CLIPModel(config), folder, words=True)


def write_tiny_siglip(folder: Path, *, any_proportions: bool = False) -> Path:
    import transformers

    text = TOWER | {"vocab_size": len(WORDS), "max_position_embeddings": 8, "pad_token_id": 0,
                    "bos_token_id": 1, "eos_token_id": 7}  # fmt: skip
    if any_proportions:
        vision = TOWER | {"num_patches": 16, "patch_size": 8}
        config = transformers.Siglip2Config(text_config=text, vision_config=vision)
        return _written(transformers.Siglip2Model(config), folder, words=True)
    vision = TOWER | {"image_size": 32, "patch_size": 8}
    config = transformers.SiglipConfig(text_config=text, vision_config=vision)
    return _written(transformers.SiglipModel(config), folder, words=True)


def write_tiny_dino(folder: Path, kind: str = "dinov2") -> Path:
    import transformers

    sizes = {"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2,
             "intermediate_size": 32, "image_size": 32, "patch_size": 8}  # fmt: skip
    config, model = {
        "dinov2": (transformers.Dinov2Config, transformers.Dinov2Model),
        "dinov2_with_registers": (
            transformers.Dinov2WithRegistersConfig,
            transformers.Dinov2WithRegistersModel,
        ),
        "dinov3_vit": (transformers.DINOv3ViTConfig, transformers.DINOv3ViTModel),
    }[kind]
    if kind != "dinov2":
        sizes["num_register_tokens"] = 3
    return _written(model(config(**sizes)), folder)


def _written(model: Any, folder: Path, *, words: bool = False) -> Path:
    rng = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(0.3 * torch.randn(parameter.shape, generator=rng))
    model.save_pretrained(folder)
    if words:
        _tokenizer().save_pretrained(folder)
    return folder


def _tokenizer() -> Any:
    from tokenizers import Tokenizer, models, pre_tokenizers, processors
    from transformers import PreTrainedTokenizerFast

    ids = {word: number for number, word in enumerate(WORDS)}
    tokenizer = Tokenizer(models.WordLevel(ids, unk_token="[UNK]"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.post_processor = processors.TemplateProcessing(
        single="[BEGIN] $A [END]", special_tokens=[("[BEGIN]", 1), ("[END]", 7)]
    )
    return PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, pad_token="[PAD]", unk_token="[UNK]", bos_token="[BEGIN]",
        eos_token="[END]",
    )  # fmt: skip
