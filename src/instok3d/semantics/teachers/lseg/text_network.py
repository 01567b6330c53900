"""The text half of LSeg: the text encoder of CLIP ViT-B/32, with the names of its first release."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from instok3d.semantics.teachers.lseg.image_network import HEAD_SIZE


@dataclass(frozen=True)
class TextSizes:
    """Sizes of the text half. The defaults are the published ones."""

    width: int = 512
    layers: int = 12
    vocabulary: int = 49408
    """Tokens."""
    longest: int = 77
    """Tokens of a text, with the two that begin and end it."""
    features: int = 512
    """D."""


class TextBlock(nn.Module):
    """A block of the encoder; a token sees those before it."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.attn = nn.MultiheadAttention(width, width // HEAD_SIZE, batch_first=True)
        self.ln_1 = nn.LayerNorm(width)
        self.mlp = nn.Module()
        self.mlp.c_fc = nn.Linear(width, 4 * width)
        self.mlp.c_proj = nn.Linear(4 * width, width)
        self.ln_2 = nn.LayerNorm(width)

    def forward(self, x: Float[Tensor, "text token c"]) -> Float[Tensor, "text token c"]:
        """The tokens after the block."""
        length, normed = x.shape[1], self.ln_1(x)
        later = torch.ones(length, length, dtype=torch.bool, device=x.device).triu(1)
        x = x + self.attn(normed, normed, normed, need_weights=False, attn_mask=later)[0]
        hidden = self.mlp.get_submodule("c_fc")(self.ln_2(x))
        # CLIP's own approximation of GELU.
        return x + self.mlp.get_submodule("c_proj")(hidden * (1.702 * hidden).sigmoid())


class TextEncoder(nn.Module):
    """Token ids to a vector in the space of LSeg's features."""

    def __init__(self, sizes: TextSizes) -> None:
        super().__init__()
        self.sizes = sizes
        self.token_embedding = nn.Embedding(sizes.vocabulary, sizes.width)
        self.positional_embedding = nn.Parameter(torch.zeros(sizes.longest, sizes.width))
        self.transformer = nn.Module()
        self.transformer.resblocks = nn.ModuleList(
            TextBlock(sizes.width) for _ in range(sizes.layers)
        )
        self.ln_final = nn.LayerNorm(sizes.width)
        self.text_projection = nn.Parameter(torch.zeros(sizes.width, sizes.features))

    def forward(self, ids: Int[Tensor, "text token"]) -> Float[Tensor, "text feature"]:
        """A vector of any length for each text.

        Args:
            ids: Padded behind the token that ends a text, which has the largest id of all.
        """
        x = self.token_embedding(ids) + self.positional_embedding[: ids.shape[1]]
        blocks = self.transformer.get_submodule("resblocks")
        assert isinstance(blocks, nn.ModuleList)
        for block in blocks:
            x = block(x)
        ends = ids.argmax(dim=1)
        return self.ln_final(x[torch.arange(len(ids)), ends]) @ self.text_projection
