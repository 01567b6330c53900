"""Transformer blocks of VGGT, and its rotary position embedding."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

ROTARY_BASE = 100.0


class RotaryTable(NamedTuple):
    """How far the channels of queries and keys are turned at each token."""

    cosine: Float[Tensor, "token 2 1 frequency"]
    """Axes in the order y, x."""
    sine: Float[Tensor, "token 2 1 frequency"]


def rotary_table(positions: Int[Tensor, "token 2"], head_width: int) -> RotaryTable:
    """Rotations for tokens at (row, column); half of a head's channels turn with each axis."""
    exponents = torch.arange(head_width // 4, device=positions.device) / (head_width // 4)
    angles = positions.float()[:, :, None, None] * ROTARY_BASE**-exponents
    return RotaryTable(angles.cos(), angles.sin())


def rotate(
    heads: Float[Tensor, "sequence head token channel"], table: RotaryTable
) -> Float[Tensor, "sequence head token channel"]:
    """Queries or keys turned by their position, in float32."""
    split = heads.float().unflatten(-1, (2, 2, -1))
    first, second = split.unbind(-2)
    turned = torch.stack([-second, first], dim=-2)
    return (split * table.cosine + turned * table.sine).flatten(-3)


class Attention(nn.Module):
    """Multi-head self-attention; queries and keys may be normalised and turned."""

    def __init__(self, width: int, num_heads: int, *, normalize_heads: bool) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.qkv = nn.Linear(width, 3 * width)
        self.q_norm = nn.LayerNorm(width // num_heads) if normalize_heads else nn.Identity()
        self.k_norm = nn.LayerNorm(width // num_heads) if normalize_heads else nn.Identity()
        self.proj = nn.Linear(width, width)

    def forward(
        self, tokens: Float[Tensor, "sequence token channel"], table: RotaryTable | None
    ) -> Float[Tensor, "sequence token channel"]:
        """What each token gathers from all tokens of its sequence."""
        mixed = self.qkv(tokens).unflatten(-1, (3, self.num_heads, -1))
        query, key, value = mixed.permute(2, 0, 3, 1, 4).unbind(0)
        query, key = self.q_norm(query), self.k_norm(key)
        if table is not None:
            query, key = rotate(query, table), rotate(key, table)
        seen = functional.scaled_dot_product_attention(
            query.to(value.dtype), key.to(value.dtype), value
        )
        return self.proj(seen.transpose(1, 2).flatten(2))


class Mlp(nn.Module):
    """Two linear layers with a GELU between them."""

    def __init__(self, width: int, hidden: int, width_out: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, hidden)
        self.fc2 = nn.Linear(hidden, width_out)

    def forward(self, tokens: Float[Tensor, "*batch channel"]) -> Float[Tensor, "*batch out"]:
        """Each token by itself."""
        return self.fc2(functional.gelu(self.fc1(tokens)))


class LayerScale(nn.Module):
    """A learned factor for each channel."""

    def __init__(self, width: int, initial: float) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.full((width,), initial))

    def forward(self, tokens: Float[Tensor, "*batch channel"]) -> Float[Tensor, "*batch channel"]:
        """The scaled tokens."""
        return tokens * self.gamma


class Block(nn.Module):
    """Pre-norm transformer block; both branches have a LayerScale."""

    def __init__(
        self,
        width: int,
        num_heads: int,
        *,
        layer_scale: float,
        normalize_heads: bool = False,
        epsilon: float = 1e-5,
    ) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=epsilon)
        self.attn = Attention(width, num_heads, normalize_heads=normalize_heads)
        self.ls1 = LayerScale(width, layer_scale)
        self.norm2 = nn.LayerNorm(width, eps=epsilon)
        self.mlp = Mlp(width, 4 * width, width)
        self.ls2 = LayerScale(width, layer_scale)

    def forward(
        self, tokens: Float[Tensor, "sequence token channel"], table: RotaryTable | None = None
    ) -> Float[Tensor, "sequence token channel"]:
        """The tokens after they have seen each other."""
        tokens = tokens + self.ls1(self.attn(self.norm1(tokens), table))
        return tokens + self.ls2(self.mlp(self.norm2(tokens)))


def run_block(block: Block, tokens: Tensor, table: RotaryTable | None, recompute: bool) -> Tensor:
    """The block's output; with `recompute` its inner values are not kept for the gradient."""
    if recompute and torch.is_grad_enabled():
        return checkpoint(block, tokens, table, use_reentrant=False)
    return block(tokens, table)
