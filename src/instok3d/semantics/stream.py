"""The semantic stream: D_anchor's frozen attention gathers 2D features into anchors (Sec. 3.3)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from instok3d.model.transformer import Decoder, DecoderLayer


class SemanticStream(nn.Module):
    """Anchor semantic tokens: what the anchors would gather if patches carried 2D features.

    It runs beside the main stream of a frozen decoder. In each of its layers it uses the same
    attention weights, with values, outputs and an MLP of its own, as C3G does it (the paper's
    reference for "reuse").
    """

    def __init__(self, feature_channels: int, decoder: Decoder, *, mlp_ratio: int = 4):
        """Maps for a decoder, which is not kept.

        Args:
            feature_channels: D, of the 2D features.
            decoder: D_anchor.
            mlp_ratio: Hidden width of the MLPs over the tokens' width; the decoder's own have 4.
        """
        super().__init__()
        width = decoder.norm.normalized_shape[0]
        self.source = nn.Sequential(nn.Linear(feature_channels, width), nn.LayerNorm(width))
        self.start = nn.Linear(width, width)
        self.layers = nn.ModuleList(
            SemanticLayer(width, mlp_ratio, self_attention=layer.self_attention is not None)
            for layer in decoder.each_layer()
        )
        self.norm = nn.LayerNorm(width)

    def forward(
        self,
        decoder: Decoder,
        seeds: Float[Tensor, "batch anchor channel"],
        context: Float[Tensor, "batch patch channel"],
        features: Float[Tensor, "batch patch feature"],
    ) -> tuple[Float[Tensor, "batch anchor channel"], Float[Tensor, "batch anchor channel"]]:
        """Anchor tokens as the decoder gives them, and anchor semantic tokens, layer-normalised.

        Not differentiable in the main stream, whose tokens have no gradient.

        Args:
            decoder: D_anchor, frozen.
            seeds: A0.
            context: X.
            features: Phi at each patch of the context.
        """
        sources, tokens = self.source(features), seeds.detach()
        context = context.detach()
        semantic = self.start(tokens)
        for frozen, own in zip(decoder.each_layer(), self.layers, strict=True):
            tokens, semantic = own(frozen, tokens, context, sources, semantic)
        with torch.no_grad():
            tokens = decoder.norm(tokens)
        return tokens, self.norm(semantic)


class SemanticLayer(nn.Module):
    """One layer of the stream beside a frozen layer of the decoder."""

    def __init__(self, width: int, mlp_ratio: int, *, self_attention: bool):
        super().__init__()
        self.cross_value = nn.Linear(width, width, bias=False)
        self.cross_out = nn.Linear(width, width)
        self.self_norm = nn.LayerNorm(width) if self_attention else None
        self.self_value = nn.Linear(width, width, bias=False) if self_attention else None
        self.self_out = nn.Linear(width, width) if self_attention else None
        hidden = mlp_ratio * width
        self.mlp = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, hidden), nn.GELU(), nn.Linear(hidden, width)
        )

    def forward(
        self,
        frozen: DecoderLayer,
        tokens: Float[Tensor, "batch anchor channel"],
        context: Float[Tensor, "batch patch channel"],
        sources: Float[Tensor, "batch patch channel"],
        semantic: Float[Tensor, "batch anchor channel"],
    ) -> tuple[Float[Tensor, "batch anchor channel"], Float[Tensor, "batch anchor channel"]]:
        """Tokens of the main stream and semantic tokens after the layer, given those before it."""
        with torch.no_grad():
            normed = frozen.cross_norm(tokens)
        gathered, other = frozen.cross_attention.forward_with(
            normed, context, self.cross_value(sources)
        )
        tokens, semantic = tokens + gathered, semantic + self.cross_out(other)
        if frozen.self_norm is not None and frozen.self_attention is not None:
            assert self.self_norm is not None
            assert self.self_value is not None
            assert self.self_out is not None
            with torch.no_grad():
                normed = frozen.self_norm(tokens)
            values = self.self_value(self.self_norm(semantic))
            gathered, other = frozen.self_attention.forward_with(normed, normed, values)
            tokens, semantic = tokens + gathered, semantic + self.self_out(other)
        with torch.no_grad():
            tokens = tokens + frozen.mlp(tokens)
        return tokens, semantic + self.mlp(semantic)
