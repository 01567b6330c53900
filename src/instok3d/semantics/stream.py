"""The semantic stream: D_anchor's frozen attention gathers 2D features into anchors (Sec. 3.3)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from instok3d.model.transformer import Decoder, DecoderLayer


class SemanticStream(nn.Module):
    """Anchor semantic tokens: what the anchors would gather if patches carried 2D features.

    The main stream of a frozen decoder is replayed. In each of its layers the semantic stream uses
    the same attention weights, with values, outputs and an MLP of its own, as C3G does it (the
    paper's reference for "reuse").
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
    ) -> Float[Tensor, "batch anchor channel"]:
        """Anchor semantic tokens, layer-normalised. Not differentiable in the main stream.

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
            semantic = own(frozen, tokens, context, sources, semantic)
            with torch.no_grad():
                tokens = frozen(tokens, context)
        return self.norm(semantic)


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
    ) -> Float[Tensor, "batch anchor channel"]:
        """The semantic tokens after the layer; `tokens` are the main stream's before it."""
        normed = frozen.cross_norm(tokens)
        gathered = frozen.cross_attention.gather_other(normed, context, self.cross_value(sources))
        semantic = semantic + self.cross_out(gathered)
        if frozen.self_norm is not None and frozen.self_attention is not None:
            assert self.self_norm is not None
            assert self.self_value is not None
            assert self.self_out is not None
            tokens = tokens + frozen.cross_attention(normed, context)
            normed = frozen.self_norm(tokens)
            values = self.self_value(self.self_norm(semantic))
            gathered = frozen.self_attention.gather_other(normed, normed, values)
            semantic = semantic + self.self_out(gathered)
        return semantic + self.mlp(semantic)
