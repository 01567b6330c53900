"""A tiny model with random weights, and photos for it."""

from pathlib import Path

import torch
from PIL import Image, ImageDraw

from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.model.files import save_model
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig

SIZES = TokenizerConfig(
    width=32, num_anchors=16, num_groups=5, anchor_layers=1, group_layers=1, head_size=16,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4, sh_degree=1),
)  # fmt: skip


def made_model(path: Path, image_side: int = 32) -> Path:
    torch.manual_seed(5)
    backbone = NanoBackbone(NanoConfig(width=32, layers=1, head_width=16, match_channels=64))
    card = {"name": "random", "image_side": image_side}
    save_model(Tokenizer(backbone, SIZES), path, card=card)
    return path


def made_photos(folder: Path, count: int = 2) -> Path:
    folder.mkdir()
    for index in range(count):
        photo = Image.new("RGB", (60, 40), (200, 190, 170))
        draw = ImageDraw.Draw(photo)
        draw.rectangle((10 + 3 * index, 15, 25 + 3 * index, 35), fill=(180, 40, 40))
        draw.ellipse((35 + 2 * index, 10, 55 + 2 * index, 30), fill=(30, 60, 160))
        photo.save(folder / f"{index}.png")
    return folder
