"""C3G (An et al., 2025): few learned Gaussian queries, features by reused attention.

Written from the paper, on our backbone. 2,048 learned queries attend with the patches of all views
to each other; each becomes one Gaussian. A second stream of values goes through the same attention
weights and lifts what a 2D encoder says of the patches into the queries; its loss moves nothing
else, so that both can be learned in one run.

Deviations, with which it begins to unfold within minutes (docs/log.md, 2026-11-30):
queries start spread over what the first camera may see and not at one point, and stay near their
start; patches also know colours and predicted points, as ours do (`ContextFusion`); patches and
queries know where they lie, and attend at first to what is near. Lengths are in mean distances of
the predicted points, as the nano backbone has no unit.
"""

from dataclasses import dataclass
from math import log

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.base import GeometryBackbone
from instok3d.baselines.feature_scene import FeatureScene
from instok3d.model.context import ContextFusion
from instok3d.model.transformer import Attention
from instok3d.semantics.model import at_patches
from instok3d.types import Gaussians, Geometry, Views


@dataclass(frozen=True)
class QueryGaussianConfig:
    """Sizes of the model beside its backbone. Lengths are in mean distances of the points."""

    num_queries: int = 2_048
    """As in the paper: so many Gaussians has a scene, of however many views."""
    width: int = 256
    """Channels of a token; C3G has VGGT's 2,048."""
    layers: int = 2
    """As in C3G."""
    head_size: int = 64
    """Channels of an attention head; C3G has 128."""
    encoder_channels: int = 256
    """D, of the 2D encoder; LSeg has 512."""
    initial_scale: float = 0.04
    """Standard deviation of a Gaussian at the start."""
    initial_opacity: float = 0.3
    """Of a Gaussian at the start."""
    reach: float = 0.2
    """Farthest that a Gaussian lies from the start of its query along each axis; unbounded, those
    that leave the view together never come back."""
    near: float = 0.2
    """Places that far from each other are unlike for attention at the start."""
    scale_max: float = 0.5
    """Largest standard deviation."""

    def __post_init__(self) -> None:
        for name in ("num_queries", "layers", "encoder_channels"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 < self.initial_scale <= self.scale_max:
            raise ValueError(
                f"initial_scale must be above 0 and at most scale_max={self.scale_max}, got "
                f"{self.initial_scale}"
            )
        if not 0 < self.initial_opacity < 1:
            raise ValueError(f"initial_opacity must be in (0, 1), got {self.initial_opacity}")
        for name in ("reach", "near"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        if self.width % 2:
            raise ValueError(f"width must be even, got {self.width}")


NEAREST, FARTHEST, SPREAD = 0.45, 1.7, 0.7
"""Where queries start: between these depths, and sideways by up to so much of the depth."""
PLACE_GAIN, QUERY_GAIN = 0.7, 0.5
"""Of the features of places, and of what else a query is at the start, in its token."""
SIZES = [3, 3, 4, 1, 3]
"""Offset, logarithm of the scale, quaternion, opacity, colour."""


class QueryGaussians(nn.Module):
    """Photos in, one Gaussian with a feature for every query out."""

    takes_features = True
    detaches_gaussians = True

    def __init__(self, backbone: GeometryBackbone, config: QueryGaussianConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = backbone
        width = config.width
        self.fusion = ContextFusion(
            backbone.feature_channels, width, patch_size=backbone.patch_size
        )
        self.queries = nn.Parameter(QUERY_GAIN * torch.randn(config.num_queries, width))
        self.frequencies = nn.Parameter(torch.randn(3, width // 2) / config.near)
        self.starts = nn.Parameter(_starts(config.num_queries))
        self.layers = nn.ModuleList(
            QueryLayer(width, config.head_size) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(width)
        self.out = nn.Linear(width, sum(SIZES))
        self.source = nn.Linear(config.encoder_channels, width)
        self.lifts = nn.ModuleList(LiftLayer(width) for _ in range(config.layers))
        self.lift_norm = nn.LayerNorm(width)
        self.expand = nn.Linear(width, config.encoder_channels, bias=False)
        nn.init.normal_(self.out.weight, std=0.005)
        nn.init.zeros_(self.out.bias)

    def forward(
        self,
        views: Views,
        encoded: Float[Tensor, "batch view feature row column"] | None = None,
        geometry: Geometry | None = None,
    ) -> FeatureScene:
        """See `FeatureModel`; without what the encoder says there are no features."""
        seen: Geometry = self.backbone(views) if geometry is None else geometry
        context = self.fusion(views, seen)
        with torch.autocast(context.tokens.device.type, enabled=False):
            patches = context.tokens.float() + self._places(context.positions)
            queries = self.queries + self._places(self.starts)
        tokens = torch.cat([patches, queries.expand(len(patches), -1, -1)], dim=1)
        stream = None if encoded is None else self._sources(views, encoded, tokens)
        for layer, lift in zip(self.layers, self.lifts, strict=True):
            if stream is not None:
                stream = lift(layer, tokens.detach(), stream)
            tokens = layer(tokens)
        raw = self.out(self.norm(tokens[:, -self.config.num_queries :]))
        features = None
        if stream is not None:
            features = self.lift_norm(stream[:, -self.config.num_queries :]).float()
        with torch.autocast(raw.device.type, enabled=False):
            gaussians = self._gaussians(raw.float(), context.scale)
        return FeatureScene(gaussians, features, self.expand.weight, seen)

    def _places(self, points: Float[Tensor, "*of 3"]) -> Float[Tensor, "*of channel"]:
        """Random Fourier features: their product falls with the distance of two points."""
        angles = points @ self.frequencies
        return PLACE_GAIN * torch.cat([angles.cos(), angles.sin()], dim=-1)

    def _sources(
        self,
        views: Views,
        encoded: Float[Tensor, "batch view feature row column"],
        tokens: Float[Tensor, "batch token channel"],
    ) -> Float[Tensor, "batch token channel"]:
        """The stream at its start: the encoder's features at the patches, and the queries."""
        height, width = views.images.shape[-2:]
        patch = self.backbone.patch_size
        patches = at_patches(encoded, height // patch, width // patch).flatten(1, 2)
        own = tokens[:, -self.config.num_queries :].detach()
        return torch.cat([self.source(patches).to(own.dtype), own], dim=1)

    def _gaussians(
        self, raw: Float[Tensor, "batch query number"], scale: Float[Tensor, " batch"]
    ) -> Gaussians:
        offsets, scales, quats, opacities, colors = raw.split(SIZES, dim=-1)
        reach, opacity = self.config.reach, self.config.initial_opacity
        whole = scale[:, None, None]
        least, most = log(1e-4), log(self.config.scale_max)
        logs = (log(self.config.initial_scale) + scales).clamp(least, most)
        upright = quats.new_tensor([1.0, 0, 0, 0])
        index = torch.arange(raw.shape[1], device=raw.device)
        return Gaussians(
            means=(self.starts + reach * torch.tanh(offsets / reach)) * whole,
            quats=functional.normalize(quats + upright, dim=-1),
            scales=logs.exp() * whole,
            opacities=torch.sigmoid(opacities[..., 0] + log(opacity / (1 - opacity))),
            sh=colors[..., None, :],
            anchor_index=index.expand(raw.shape[:2]),
        )


class QueryLayer(nn.Module):
    """Pre-norm self-attention over patches and queries together, then an MLP."""

    def __init__(self, width: int, head_size: int) -> None:
        super().__init__()
        self.attention_norm = nn.LayerNorm(width)
        self.attention = Attention(width, head_size=head_size)
        with torch.no_grad():  # at the start a token attends to those that are like it
            nn.init.orthogonal_(self.attention.query.weight)
            self.attention.key_value.weight[:width] = self.attention.query.weight
        self.mlp = _mlp(width)

    def forward(
        self, tokens: Float[Tensor, "batch token channel"]
    ) -> Float[Tensor, "batch token channel"]:
        """The tokens after the layer."""
        normed = self.attention_norm(tokens)
        tokens = tokens + self.attention(normed, normed)
        return tokens + self.mlp(tokens)


class LiftLayer(nn.Module):
    """One layer of the second stream: values and an MLP of its own, the main stream's attention."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.value = nn.Linear(width, width, bias=False)
        self.out = nn.Linear(width, width)
        self.mlp = _mlp(width)

    def forward(
        self,
        layer: QueryLayer,
        tokens: Float[Tensor, "batch token channel"],
        stream: Float[Tensor, "batch token channel"],
    ) -> Float[Tensor, "batch token channel"]:
        """The stream after the layer. Nothing of the main stream learns.

        Args:
            layer: Of the main stream.
            tokens: Of the main stream before it, detached.
            stream: Before it.
        """
        with torch.no_grad():
            normed = layer.attention_norm(tokens)
            query = layer.attention.query(normed)
            key = functional.linear(normed, layer.attention.key_value.weight.chunk(2)[0])
        size = layer.attention.head_size
        query, key, value = (each.unflatten(-1, (-1, size)).transpose(1, 2)
                 for each in (query, key, self.value(stream)))  # fmt: skip
        gathered = functional.scaled_dot_product_attention(query, key, value)
        stream = stream + self.out(gathered.transpose(1, 2).flatten(2))
        return stream + self.mlp(stream)


def _starts(count: int) -> Float[Tensor, "query 3"]:
    """Places in the view of the first camera."""
    draws = torch.rand(count, 3)
    depths = NEAREST + (FARTHEST - NEAREST) * draws[:, 2:]
    sideways = SPREAD * (2 * draws[:, :2] - 1) * depths
    return torch.cat([sideways, depths], dim=1)


def _mlp(width: int) -> nn.Sequential:
    return nn.Sequential(
        nn.LayerNorm(width), nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
    )
