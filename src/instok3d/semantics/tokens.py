"""Semantic tokens: a shared feature for each group, a short residual for each anchor (Eq. 7)."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.model.transformer import Decoder
from instok3d.render import render
from instok3d.types import Cameras, Flow, Gaussians

Levels = Literal["group and anchor", "group", "anchor"]
"""Of the features that a scene has: the paper's two, or one alone (Table 4)."""


@dataclass(frozen=True)
class SemanticTokens(Flow):
    """What a scene stores of its semantic features."""

    shared: Float[Tensor, "batch group basis feature"]
    """s: one feature for each group, as in the paper; or several, which its anchors mix."""
    residuals: Float[Tensor, "batch anchor residual"]
    """r."""
    mixing: Float[Tensor, "batch anchor basis"]
    """How much each anchor has of each shared feature of its group; rows sum to 1."""
    residual_map: Float[Tensor, "feature residual"]
    """W_r; of the model, the same for all scenes."""

    @property
    def num_scalars(self) -> int:
        """Numbers stored for a scene: s, r, and the mixing where there is something to mix."""
        stored = [self.shared[0], self.residuals[0]]
        if self.shared.shape[2] > 1:
            stored.append(self.mixing[0])
        return sum(each.numel() for each in stored)


def turned(
    shared: Float[Tensor, "group basis feature"],
    means: Float[Tensor, "group feature"],
    wanted: Float[Tensor, "group feature"],
    known: Bool[Tensor, " group"],
) -> Float[Tensor, "group basis feature"]:
    """Shared features whose mean points elsewhere and is as long as before.

    Each of a group's features differs from their mean as before: what tells parts apart stays.

    Args:
        shared: s of one scene.
        means: Of the shared features of each group, as its anchors mix them.
        wanted: Where each mean should point; of any length.
        known: Of which groups; the others keep what they have.
    """
    aimed = functional.normalize(wanted, dim=1) * means.norm(dim=1, keepdim=True)
    return torch.where(known[:, None, None], aimed[:, None] + (shared - means[:, None]), shared)


@dataclass(frozen=True)
class SemanticTokensConfig:
    """Sizes of the semantic tokens. The defaults are the paper's."""

    feature_channels: int = 512
    """D, of the 2D features (LSeg)."""
    residual_channels: int = 8
    """d (Sec. 4)."""
    group_layers: int = 4
    """Of the semantic group decoder; the paper's anchor-group decoder has as many (Sec. 4)."""
    stream_mlp_ratio: int = 4
    """Hidden width of the semantic stream's MLPs over the tokens' width."""
    num_basis: int = 1
    """Shared features for each group; more than the paper's one can tell parts of a thing apart."""
    levels: Levels = "group and anchor"
    """Which level is there; the other one is zero. With anchors alone F = W_r R^, of rank d."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "levels" and value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}")
        if self.levels == "anchor" and self.num_basis > 1:
            raise ValueError(
                f"num_basis is {self.num_basis}, but levels 'anchor' has no shared feature: give 1"
            )


class SemanticDecoder(nn.Module):
    """Anchor semantic tokens to s, r and W_r (Sec. 3.3).

    The queries of the group decoder are a linear projection of the decoded group tokens.
    """

    def __init__(self, width: int, config: SemanticTokensConfig, *, head_size: int = 64):
        super().__init__()
        self.config = config
        self.groups = config.levels != "anchor"
        self.anchors = config.levels != "group"
        if self.groups:
            self.query = nn.Linear(width, width)
            self.decoder = Decoder(
                width, config.group_layers, self_attention=False, head_size=head_size
            )
            self.shared = nn.Linear(width, config.num_basis * config.feature_channels)
        if self.anchors:
            self.residual = nn.Linear(width, config.residual_channels)
            self.residual_map = nn.Linear(
                config.residual_channels, config.feature_channels, bias=False
            )
        self.mixing = nn.Linear(width, config.num_basis) if config.num_basis > 1 else None

    def forward(
        self,
        semantic: Float[Tensor, "batch anchor channel"],
        groups: Float[Tensor, "batch group channel"],
    ) -> SemanticTokens:
        """The semantic tokens of scenes; zeros at a level that is not there.

        Args:
            semantic: Anchor semantic tokens.
            groups: G, detached here.
        """
        sizes = self.config
        shared = semantic.new_zeros(*groups.shape[:2], sizes.num_basis, sizes.feature_channels)
        if self.groups:
            decoded = self.decoder(self.query(groups.detach()), semantic)
            shared = self.shared(decoded).unflatten(-1, (sizes.num_basis, -1))
        residuals = semantic.new_zeros(*semantic.shape[:2], sizes.residual_channels)
        residual_map = semantic.new_zeros(sizes.feature_channels, sizes.residual_channels)
        if self.anchors:
            residuals, residual_map = self.residual(semantic), self.residual_map.weight
        if self.mixing is None:
            mixing = semantic.new_ones(*semantic.shape[:2], 1)
        else:
            mixing = self.mixing(semantic).float().softmax(dim=-1)
        return SemanticTokens(shared.float(), residuals.float(), mixing, residual_map)


@dataclass(frozen=True)
class SemanticMaps(Flow):
    """Rendered semantic tokens, before they become features."""

    shares: Float[Tensor, "batch view group basis height width"]
    """S^: how much of each pixel each shared feature has; not divided by alpha."""
    residuals: Float[Tensor, "batch view residual height width"]
    """R^, composited as colours are."""


def render_semantics(
    gaussians: Gaussians,
    assignment: Float[Tensor, "batch anchor column"],
    tokens: SemanticTokens,
    cameras: Cameras,
    height: int,
    width: int,
    *,
    near: float = 0.05,
    far: float = 100.0,
) -> SemanticMaps:
    """Group assignment maps and residual maps, composited in one call (Sec. 3.3).

    Each anchor takes the shared feature of its most probable group, also where the void is more
    probable still: the paper has it so, and what lies nowhere is like its surroundings.
    Differentiable in the tokens alone.

    Args:
        gaussians: Of the scenes, detached here.
        assignment: pi, a column for each group and the void's last.
        tokens: Of the same scenes.
        cameras: To look from.
        height: Of the maps, pixels.
        width: Likewise.
        near: Gaussians nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
    """
    groups, basis = tokens.shared.shape[1:3]
    owner = tokens.mixing.new_zeros(*assignment.shape[:2], groups)
    if groups:
        owner.scatter_(2, assignment[..., :-1].argmax(dim=-1, keepdim=True), 1.0)
    shares = (owner[..., None] * tokens.mixing[:, :, None]).flatten(2)
    rendering = render(
        gaussians.map(torch.Tensor.detach), cameras, height, width,
        anchor_features=torch.cat([shares, tokens.residuals], dim=-1), near=near, far=far,
    )  # fmt: skip
    assert rendering.features is not None
    maps, residuals = rendering.features.split([groups * basis, tokens.residuals.shape[2]], dim=2)
    return SemanticMaps(maps.unflatten(2, (groups, basis)), residuals)


def pixel_features(
    maps: SemanticMaps, tokens: SemanticTokens
) -> Float[Tensor, "batch view feature height width"]:
    """F = sum_l S^_l s_l + W_r R^ for every pixel (Eq. 7)."""
    shared = torch.einsum("bvgkhw,bgkd->bvdhw", maps.shares, tokens.shared)
    return shared + torch.einsum("bvrhw,dr->bvdhw", maps.residuals, tokens.residual_map)
