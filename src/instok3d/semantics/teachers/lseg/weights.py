"""LSeg's published weights: sizes and networks of a converted checkpoint.

The checkpoint (`demo_e200.ckpt`) keeps its tensors under `state_dict`, with these names:

    net.pretrained.model.*            ViT-L/16-384, named as timm names them
    net.pretrained.act_postprocessN.* tokens to the scales N = 1 to 4
    net.scratch.layerN_rn, .refinenetN.*, .head1.*   the convolutional part
    net.clip_pretrained.*             CLIP ViT-B/32, named as its first release names them

`instok3d models convert demo_e200.ckpt -o lseg.safetensors` writes them without a pickle.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor, nn

from instok3d.reading import naming_damage, reason_of
from instok3d.semantics.teachers.lseg.image_network import (
    HEAD_SIZE,
    ImageSizes,
    Pretrained,
    Scratch,
)
from instok3d.semantics.teachers.lseg.text_network import TextEncoder, TextSizes
from instok3d.weights.reading import read_weights_file

PREFIX = "net."
"""Of every tensor of the checkpoint, whose training module held the network under this name."""
NOT_READ = (
    "pretrained.model.norm.",
    "pretrained.model.head.",
    "scratch.refinenet4.resConfUnit1.",  # the coarsest scale has nothing to join
    "clip_pretrained.visual.",
    "clip_pretrained.logit_scale",
)
"""What the checkpoint holds and features do not need."""
REMEDY = "convert the checkpoint demo_e200.ckpt again (docs/models.md)"


@dataclass(frozen=True)
class LSegNetworks:
    """Both halves of LSeg, in eval mode."""

    pretrained: Pretrained
    scratch: Scratch
    text: TextEncoder


def load_networks(path: Path) -> LSegNetworks:
    """The networks of a converted checkpoint, on the CPU; their sizes are those of its tensors.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or holds other tensors than LSeg's.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there are no weights of LSeg in {path}: see docs/models.md")
    raw, _ = read_weights_file(path, REMEDY)
    weights = {name.removeprefix(PREFIX): value for name, value in raw.items()}
    weights = {name: each for name, each in weights.items() if not name.startswith(NOT_READ)}
    with naming_damage(path, f"it is not LSeg's; {REMEDY}"):
        text = {name: each for name, each in weights.items() if name.startswith("clip_pretrained.")}
        whole = nn.ModuleDict(
            {
                "pretrained": Pretrained(image_sizes(weights)),
                "scratch": Scratch(image_sizes(weights)),
                "clip_pretrained": TextEncoder(text_sizes(text)),
            }
        )
    try:
        whole.load_state_dict(weights)
    except RuntimeError as error:
        raise ValueError(f"{path} does not hold LSeg: {reason_of(error)}; {REMEDY}") from error
    whole.eval().requires_grad_(False)
    parts = whole["pretrained"], whole["scratch"], whole["clip_pretrained"]
    return LSegNetworks(*parts)  # pyright: ignore[reportArgumentType]


def image_sizes(weights: Mapping[str, Tensor]) -> ImageSizes:
    """Sizes of the image half of which these are the tensors."""
    tokens = weights["pretrained.model.pos_embed"].shape[1] - 1
    kernel = weights["pretrained.model.patch_embed.proj.weight"]
    width, depth = kernel.shape[0], _count(weights, "pretrained.model.blocks.")
    if round(tokens**0.5) ** 2 != tokens or width % HEAD_SIZE or depth % 4 or not depth:
        raise ValueError(f"{tokens} positions, {depth} blocks of {width} channels")
    return ImageSizes(
        width=width,
        depth=depth,
        patch=kernel.shape[2],
        grid=round(tokens**0.5),
        scale_channels=tuple(
            weights[f"scratch.layer{number}_rn.weight"].shape[1] for number in (1, 2, 3, 4)
        ),
        fused=weights["scratch.head1.weight"].shape[1],
        features=weights["scratch.head1.weight"].shape[0],
    )


def text_sizes(weights: Mapping[str, Tensor]) -> TextSizes:
    """Sizes of the text half of which these are the tensors."""
    vocabulary, width = weights["clip_pretrained.token_embedding.weight"].shape
    if width % HEAD_SIZE or not width:
        raise ValueError(f"a text encoder of {width} channels")
    return TextSizes(
        width=width,
        layers=_count(weights, "clip_pretrained.transformer.resblocks."),
        vocabulary=vocabulary,
        longest=weights["clip_pretrained.positional_embedding"].shape[0],
        features=weights["clip_pretrained.text_projection"].shape[1],
    )


def _count(weights: Mapping[str, Tensor], prefix: str) -> int:
    names = [name.removeprefix(prefix) for name in weights if name.startswith(prefix)]
    return 1 + max((int(name.split(".")[0]) for name in names), default=-1)
