"""The semantic model: a frozen tokenizer, 2D features of its photos, and what they become."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.model.tokenizer import Tokenizer
from instok3d.model.transformer import Decoder
from instok3d.semantics.stream import SemanticStream
from instok3d.semantics.tokens import SemanticDecoder, SemanticTokens, SemanticTokensConfig
from instok3d.types import Anchors, Context, Geometry, TokenGroups, Views


@dataclass(frozen=True)
class PatchLift:
    """Features of every patch, on their way into the anchors."""

    stream: SemanticStream
    features: Float[Tensor, "batch view patch feature"]

    def __call__(self, decoder: Decoder, seeds: Anchors, context: Context) -> Anchors:
        """Decoded anchors with their semantic tokens; the context has the patches of all views."""
        features = self.features.flatten(1, 2)
        tokens, lifted = self.stream(decoder, seeds.tokens, context.tokens, features)
        return replace(seeds, tokens=tokens, lifted=lifted)

    def cut(self, scene: int, window: Sequence[int]) -> "PatchLift":
        """The features of one scene's views of a window."""
        return replace(self, features=self.features[scene, list(window)][None])


class SemanticModel(nn.Module):
    """Semantic tokens of a scene, from 2D features of its context photos (Sec. 3.3).

    It belongs to one tokenizer, which stays outside: it is frozen, and its groups do not change.
    Of more views than the tokenizer takes at once, anchors carry their semantic tokens through the
    windows, and the group decoder runs once on all of them.
    """

    def __init__(self, tokenizer: Tokenizer, config: SemanticTokensConfig):
        """New weights for a tokenizer.

        Args:
            tokenizer: Gives the sizes; it is not kept.
            config: Of the semantic tokens.
        """
        super().__init__()
        self.stream = SemanticStream(
            config.feature_channels, tokenizer.anchor_decoder.decoder,
            mlp_ratio=config.stream_mlp_ratio,
        )  # fmt: skip
        sizes = tokenizer.config
        self.decoder = SemanticDecoder(sizes.width, config, head_size=sizes.head_size)

    @torch.no_grad()
    def start_from(self, other: "SemanticModel") -> None:
        """Take the weights of a model of the same tokenizer; what that one lacks stays as it is.

        Where this one has several shared features for each group, all begin as the other's one;
        the mixing of anchors, which is new then, tells them apart.

        Raises:
            ValueError: It has other sizes, or several shared features and not as many.
        """
        own, theirs = self.decoder.config, other.decoder.config
        alike = replace(theirs, num_basis=own.num_basis, levels=own.levels) == own
        if not alike or theirs.num_basis not in (1, own.num_basis):
            raise ValueError(f"weights of sizes {theirs} do not fit {own}: take the same sizes")
        given = other.state_dict()
        for name in ("decoder.shared.weight", "decoder.shared.bias"):
            if name in given:
                given[name] = torch.cat([given[name]] * (own.num_basis // theirs.num_basis))
        state = self.state_dict()
        self.load_state_dict(state | {name: given[name] for name in state if name in given})

    def forward(
        self,
        tokenizer: Tokenizer,
        views: Views,
        features: Float[Tensor, "batch view feature rows columns"],
        geometry: Geometry | None = None,
    ) -> tuple[TokenGroups, SemanticTokens]:
        """The tokenizer's scene, as it is without semantics, and its semantic tokens.

        Not differentiable in what the tokenizer makes.

        Args:
            tokenizer: The one that this model was made for.
            views: Context photos.
            features: Phi of the photos, at any resolution.
            geometry: See `Tokenizer.forward`.
        """
        groups = tokenizer(views, geometry, self.lift(tokenizer, views, features))
        return groups, self.tokens(groups)

    def lift(
        self,
        tokenizer: Tokenizer,
        views: Views,
        features: Float[Tensor, "batch view feature rows columns"],
    ) -> PatchLift:
        """What the tokenizer is to carry along; see `forward`."""
        height, width = views.images.shape[-2:]
        patch = tokenizer.backbone.patch_size
        return PatchLift(self.stream, at_patches(features, height // patch, width // patch))

    def tokens(self, groups: TokenGroups) -> SemanticTokens:
        """The semantic tokens of groups whose anchors carry theirs, those that are left."""
        if groups.anchors.lifted is None:
            raise ValueError("no features were lifted into these groups")
        return self.decoder(groups.anchors.lifted, groups.tokens)


def at_patches(
    features: Float[Tensor, "batch view feature rows columns"], rows: int, columns: int
) -> Float[Tensor, "batch view patch feature"]:
    """Features of each patch, row-major: means of finer maps, interpolated from coarser ones."""
    resized = functional.interpolate(
        features.flatten(0, 1), (rows, columns), mode="bilinear", antialias=True
    )
    return resized.unflatten(0, features.shape[:2]).flatten(3).mT
