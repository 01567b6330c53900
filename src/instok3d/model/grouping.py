"""Groups: learned queries become the objects of a scene, and anchors are shared among them."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from instok3d.model.transformer import Decoder
from instok3d.types import Anchors


class GroupDecoder(nn.Module):
    """D_group: L learned queries gather from the anchors and become group tokens G (Eq. 2)."""

    def __init__(self, num_groups: int, width: int, decoder: Decoder):
        super().__init__()
        self.queries = nn.Parameter(0.5 * torch.randn(num_groups, width))
        self.decoder = decoder

    def forward(self, anchors: Anchors) -> Float[Tensor, "batch group channel"]:
        """G for each scene."""
        queries = self.queries.expand(len(anchors.tokens), -1, -1)
        return self.decoder(queries, anchors.tokens)


class Assignment(nn.Module):
    """pi: which group each anchor belongs to, as probabilities (Eq. 3).

    Dot products of the decoded tokens themselves would be far too large for a softmax. Both are
    projected (unless `project` is off, as in the paper) and layer-normalised, and the product is
    divided by sqrt(C): about unit variance at the start, at most sqrt(C) when a pair agrees,
    times a learned temperature.
    """

    def __init__(self, width: int, *, project: bool = True):
        super().__init__()

        def projection() -> nn.Sequential:
            maps = [nn.Linear(width, width)] if project else []
            return nn.Sequential(*maps, nn.LayerNorm(width))

        self.anchor_proj, self.group_proj = projection(), projection()
        self.log_temperature = nn.Parameter(torch.zeros(()))

    def forward(
        self,
        anchor_tokens: Float[Tensor, "batch anchor channel"],
        group_tokens: Float[Tensor, "batch group channel"],
    ) -> Float[Tensor, "batch anchor group+1"]:
        """Rows sum to 1; the last column is the void. Float32, whatever the tokens are in."""
        anchors = self.anchor_proj(anchor_tokens)
        groups = self.group_proj(group_tokens)
        with torch.autocast(anchors.device.type, enabled=False):
            factor = self.log_temperature.float().exp() / anchors.shape[-1] ** 0.5
            return assign_anchors(factor * anchors.float(), groups.float())


def assign_anchors(
    anchor_tokens: Float[Tensor, "batch anchor channel"],
    group_tokens: Float[Tensor, "batch group channel"],
) -> Float[Tensor, "batch anchor group+1"]:
    """Soft assignment of every anchor to one of the groups, or to none of them.

    Groups compete for an anchor through a softmax over dot products. A last, constant zero logit
    is the void: anchors of no instance go there (Eq. 3 and Sec. 3.2).
    """
    logits = anchor_tokens @ group_tokens.mT
    void = logits.new_zeros(*logits.shape[:-1], 1)
    return torch.cat([logits, void], dim=-1).softmax(dim=-1)
