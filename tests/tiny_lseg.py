"""LSeg of random weights and few channels, with the names of the published checkpoint."""

from pathlib import Path

import torch
from torch import Tensor, nn

from instok3d.semantics.teachers.lseg.image_network import ImageSizes, Pretrained, Scratch
from instok3d.semantics.teachers.lseg.text_network import TextEncoder, TextSizes

MERGES = (("c", "h"), ("ch", "a"), ("i", "r</w>"), ("cha", "ir</w>"), ("d", "o"), ("o", "r</w>"))
IMAGE = ImageSizes(
    width=64, depth=4, patch=16, grid=3, scale_channels=(4, 6, 8, 10), fused=8, features=12
)
TEXT = TextSizes(width=64, layers=2, vocabulary=512 + len(MERGES) + 2, longest=10, features=12)


def random_(module: nn.Module, seed: int = 0) -> nn.Module:
    """The module with all its weights and statistics drawn anew."""
    rng = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, value in module.state_dict().items():
            if name.endswith("running_var"):
                value.copy_(0.5 + torch.rand(value.shape, generator=rng))
            elif value.is_floating_point():
                value.copy_(0.2 * torch.randn(value.shape, generator=rng))
    return module.eval()


def published_state(seed: int = 0) -> dict[str, Tensor]:
    """Tensors as the checkpoint has them, those that nobody reads included."""
    network = nn.ModuleDict(
        {"pretrained": Pretrained(IMAGE), "scratch": Scratch(IMAGE),
         "clip_pretrained": TextEncoder(TEXT)}
    )  # fmt: skip
    state = {f"net.{name}": each for name, each in random_(network, seed).state_dict().items()}
    return state | {
        "net.pretrained.model.norm.weight": torch.ones(IMAGE.width),
        "net.pretrained.model.head.weight": torch.zeros(1000, IMAGE.width),
        "net.scratch.refinenet4.resConfUnit1.conv1.weight": torch.zeros(8, 8, 3, 3),
        "net.clip_pretrained.visual.proj": torch.zeros(8, 12),
        "net.clip_pretrained.logit_scale": torch.tensor(4.6),
    }


def write_merges(folder: Path) -> Path:
    """`merges.txt` of CLIP with a few merges."""
    lines = ["#version: 0.2", *(" ".join(pair) for pair in MERGES)]
    path = folder / "merges.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
