"""Anchors: context tokens at farthest points of the scene, then refined by all of it (Eq. 1, 2)."""

from dataclasses import replace

import torch
from jaxtyping import Int
from torch import Tensor, nn

from instok3d.geometry.sampling import farthest_points
from instok3d.model.transformer import Decoder
from instok3d.types import Anchors, Context


def gather_rows(
    values: Tensor,
    rows: Int[Tensor, "batch picked"],
) -> Tensor:
    """values[b, rows[b]] for every b: the chosen rows of [batch row ...]."""
    batch = torch.arange(len(rows), device=rows.device)[:, None]
    return values[batch, rows]


class AnchorPlacement(nn.Module):
    """a and A0 = X[a] + phi_pos(a): seeds at the farthest points of the patch centres (Eq. 1)."""

    def __init__(self, width: int, num_anchors: int, *, pad_duplicates: bool = False):
        super().__init__()
        self.num_anchors = num_anchors
        self.pad_duplicates = pad_duplicates
        self.position_embedding = nn.Sequential(
            nn.Linear(3, width), nn.GELU(), nn.Linear(width, width)
        )

    def forward(self, context: Context) -> Anchors:
        """Seeds, no more than there are patches, all distinct unless copies were asked for.

        With at least as many anchors as patches every patch gets one, in order: farthest points
        would only permute them, and nothing behind depends on their order. Copies follow the
        farthest points in their order, as in the paper's released scenes.
        """
        batch, patches, _ = context.positions.shape
        if self.pad_duplicates and self.num_anchors > patches:
            distinct = farthest_points(context.positions, patches)
            copies = distinct[:, :1].expand(-1, self.num_anchors - patches)
            picked = torch.cat([distinct, copies], dim=1)
        elif self.num_anchors >= patches:
            picked = torch.arange(patches, device=context.positions.device).expand(batch, -1)
        else:
            picked = farthest_points(context.positions, self.num_anchors)
        positions = gather_rows(context.positions, picked)
        with torch.autocast(positions.device.type, enabled=False):
            embedded = self.position_embedding(positions)
        return Anchors(positions, gather_rows(context.tokens, picked) + embedded, picked)


class AnchorDecoder(nn.Module):
    """D_anchor: every anchor gathers from the patches of all views (Eq. 2)."""

    def __init__(self, decoder: Decoder):
        super().__init__()
        self.decoder = decoder

    def forward(self, seeds: Anchors, context: Context) -> Anchors:
        """The same anchors with decoded tokens A."""
        return replace(seeds, tokens=self.decoder(seeds.tokens, context.tokens))
