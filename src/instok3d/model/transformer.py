"""The attention layer that every decoder is made of: D_anchor and D_group (Eq. 2)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional


class Attention(nn.Module):
    """Multi-head attention of tokens to a context, heads of a fixed size.

    No bias in the query, key and value projections. Heads of 64 channels: 32 take twice as long
    on a CPU.
    """

    def __init__(self, width: int, *, head_size: int = 64, normalize_heads: bool = False):
        super().__init__()
        if width % head_size:
            raise ValueError(
                f"width must be a multiple of head_size={head_size}, got width={width}"
            )
        self.head_size = head_size
        self.query = nn.Linear(width, width, bias=False)
        self.key_value = nn.Linear(width, 2 * width, bias=False)
        self.query_norm = nn.LayerNorm(head_size) if normalize_heads else nn.Identity()
        self.key_norm = nn.LayerNorm(head_size) if normalize_heads else nn.Identity()
        self.out = nn.Linear(width, width)

    def forward(
        self,
        tokens: Float[Tensor, "batch token channel"],
        context: Float[Tensor, "batch source channel"],
    ) -> Float[Tensor, "batch token channel"]:
        """What each token gathers from the context (for self-attention, from the tokens)."""
        return self.out(_gather(*self._heads(tokens, context)))

    def forward_with(
        self,
        tokens: Float[Tensor, "batch token channel"],
        context: Float[Tensor, "batch source channel"],
        others: Float[Tensor, "batch source channel"],
    ) -> tuple[Float[Tensor, "batch token channel"], Float[Tensor, "batch token channel"]]:
        """As `forward`, and other values of the context gathered by the same weights.

        Neither this layer's own values nor its output map take part in the second. It is
        differentiable in the other values alone, the first not at all.
        """
        with torch.no_grad():
            query, key, value = self._heads(tokens, context)
            own = self.out(_gather(query, key, value))
        return own, _gather(query, key, others.unflatten(-1, (-1, self.head_size)))

    def _heads(
        self,
        tokens: Float[Tensor, "batch token channel"],
        context: Float[Tensor, "batch source channel"],
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Queries of the tokens, keys and values of the context: [batch row head size]."""
        key, value = self.key_value(context).unflatten(-1, (2, -1, self.head_size)).unbind(-3)
        query = self.query(tokens).unflatten(-1, (-1, self.head_size))
        return self.query_norm(query), self.key_norm(key), value


def _gather(
    query: Float[Tensor, "batch token head size"],
    key: Float[Tensor, "batch source head size"],
    value: Float[Tensor, "batch source head size"],
) -> Float[Tensor, "batch token channel"]:
    """Values gathered head by head, the heads side by side."""
    query, key = query.to(value.dtype), key.to(value.dtype)
    gathered = functional.scaled_dot_product_attention(
        query.transpose(1, 2), key.transpose(1, 2), value.transpose(1, 2)
    )
    return gathered.transpose(1, 2).flatten(2)


class DecoderLayer(nn.Module):
    """Pre-norm layer: cross-attention to the context, optional self-attention, MLP (x4, GELU)."""

    def __init__(self, width: int, *, head_size: int, normalize_heads: bool, self_attention: bool):
        super().__init__()

        def attention() -> Attention:
            return Attention(width, head_size=head_size, normalize_heads=normalize_heads)

        self.cross_norm = nn.LayerNorm(width)
        self.cross_attention = attention()
        self.self_norm = nn.LayerNorm(width) if self_attention else None
        self.self_attention = attention() if self_attention else None
        self.mlp = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width)
        )

    def forward(
        self,
        tokens: Float[Tensor, "batch token channel"],
        context: Float[Tensor, "batch source channel"],
    ) -> Float[Tensor, "batch token channel"]:
        """The tokens after one round of gathering from the context."""
        tokens = tokens + self.cross_attention(self.cross_norm(tokens), context)
        if self.self_norm is not None and self.self_attention is not None:
            normed = self.self_norm(tokens)
            tokens = tokens + self.self_attention(normed, normed)
        return tokens + self.mlp(tokens)


class Decoder(nn.Module):
    """D(Q, Z): queries Q gather from a context Z, layer by layer (Eq. 2).

    The context is normalised already where it is made. The paper's text and figure show
    cross-attention and MLP alone; self-attention between the queries is a switch.
    """

    def __init__(
        self,
        width: int,
        layers: int,
        *,
        self_attention: bool,
        head_size: int = 64,
        normalize_heads: bool = False,
    ):
        super().__init__()
        self.layers = nn.ModuleList(
            DecoderLayer(
                width,
                head_size=head_size,
                normalize_heads=normalize_heads,
                self_attention=self_attention,
            )
            for _ in range(layers)
        )
        self.norm = nn.LayerNorm(width)

    def each_layer(self) -> list[DecoderLayer]:
        """The layers in their order, to be run one by one."""
        return [layer for layer in self.layers if isinstance(layer, DecoderLayer)]

    def forward(
        self,
        queries: Float[Tensor, "batch token channel"],
        context: Float[Tensor, "batch source channel"],
    ) -> Float[Tensor, "batch token channel"]:
        """The decoded queries, layer-normalised."""
        if torch.is_autocast_enabled(context.device.type):
            # One cast for all layers instead of one in each.
            context = context.to(torch.get_autocast_dtype(context.device.type))
        for layer in self.layers:
            queries = layer(queries, context)
        return self.norm(queries)
