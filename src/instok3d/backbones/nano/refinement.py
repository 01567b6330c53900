"""Depth moved to where the matches in other views put it.

One view tells depth by how things look, two views by how far they move. Once the cameras are
solved, each match says what the depth of its cell should be. What that is worth depends on the
parallax, on the match and on its neighbours, which a small network learns.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.nano.layers import SelfAttentionBlock, convolve
from instok3d.backbones.nano.matching import MATCH_STRIDE
from instok3d.backbones.nano.pair_matches import (
    MatchedCells,
    PairMatches,
    PhotoViews,
    matched_cells,
)
from instok3d.backbones.nano.threads import one_thread
from instok3d.geometry.cameras import invert_rigid

NEAREST = 0.05
"""Depth at which a point counts as behind a camera, in the network's units."""
TYPICAL_DEVIATION = 0.06
"""Of log depth: evidence that is as sure as this is half believed before the network looks."""


@dataclass(frozen=True)
class ParallaxEvidence:
    """What the matches in other views say of the depth of each cell, over all those views."""

    residuals: Float[Tensor, "batch view cell"]
    """Change of log depth that brings the projections nearest to the matches; weighted mean."""
    weights: Float[Tensor, "batch view cell"]
    """Sum of trust times precision of that change: of the matches, by their parallax."""
    trust: Float[Tensor, "batch view cell"]
    """Of the best match."""
    misses: Float[Tensor, "batch view cell"]
    """Distance in x/z, y/z that no depth explains; weighted mean."""
    matched: Float[Tensor, "batch view cell"]
    """1 in views that were matched with another one, else 0."""


@one_thread()
@torch.no_grad()
def gather_evidence(
    pairs: list[PairMatches], views: PhotoViews, cam_from_first: Float[Tensor, "batch view 4 4"]
) -> ParallaxEvidence:
    """What all pairs of views say of each view's depth; not differentiable.

    Args:
        pairs: The matches, of all cells.
        views: With the depths that are predicted so far.
        cam_from_first: The solved cameras, in units of the depths.
    """
    batch, count, height, width = views.depths.shape
    scenes = torch.arange(batch, device=views.depths.device)
    cells = (height // MATCH_STRIDE) * (width // MATCH_STRIDE)
    residuals, weights, trust, misses, matched = views.depths.new_zeros(5, batch, count, cells)
    cameras = cam_from_first.to(views.depths)
    for pair in pairs:
        for (here, there, _), way in zip(pair.ways, matched_cells(pair, views), strict=True):
            there_from_here = cameras[scenes, there] @ invert_rigid(cameras[scenes, here])
            residual, weight, miss = measure_parallax(way, there_from_here)
            residuals[scenes, here] += residual * weight
            misses[scenes, here] += miss * weight
            weights[scenes, here] += weight
            trust[scenes, here] = torch.maximum(trust[scenes, here], way.trust)
            matched[scenes, here] = 1.0
    total = weights.clamp_min(1e-9)
    return ParallaxEvidence(residuals / total, weights, trust, misses / total, matched)


def measure_parallax(
    way: MatchedCells, other_from_here: Float[Tensor, "batch 4 4"]
) -> tuple[Float[Tensor, "batch cell"], Float[Tensor, "batch cell"], Float[Tensor, "batch cell"]]:
    """(residual, weight, miss) of each cell by its match in one other view.

    One Gauss-Newton step of the log depth on the distance between projection and match, measured
    by the match's precision. The miss is a distance in x/z, y/z.
    """
    turned = way.points @ other_from_here[:, :3, :3].mT
    seen = turned + other_from_here[:, None, :3, 3]
    depth = seen[..., 2:].clamp_min(NEAREST)
    projected = seen[..., :2] / depth
    slope = (turned[..., :2] - projected * turned[..., 2:]) / depth  # d projected / d log depth
    error = way.rays - projected
    pull = (way.precision @ slope[..., None])[..., 0]
    precision = (slope * pull).sum(-1)
    residual = (pull * error).sum(-1) / precision.clamp_min(1e-9)
    miss = (error - slope * residual[..., None]).norm(dim=-1)
    weight = way.trust * precision * (seen[..., 2] > NEAREST)
    return residual.clamp(-1, 1), weight, miss.clamp_max(1)


class DepthRefinement(nn.Module):
    """Corrections of log depth and log confidence from the evidence and the views' features.

    It starts as no correction at all.
    """

    def __init__(self, width: int, head_width: int, layers: int, quarter_channels: int) -> None:
        super().__init__()
        self.look = nn.Sequential(convolve(7 + quarter_channels, 64), convolve(64, 64))
        self.gather = nn.Conv2d(64, width, 2, 2)
        self.describe = nn.Linear(2 * width, width)
        self.blocks = nn.ModuleList(SelfAttentionBlock(width, head_width) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.spread = nn.Linear(width, 4 * 32)
        self.keep = nn.Conv2d(64, 32, 1)
        self.mix = convolve(32, 32)
        self.correct = nn.Conv2d(32, 2, 1)
        for parameter in self.correct.parameters():
            nn.init.zeros_(parameter)

    def forward(
        self,
        evidence: ParallaxEvidence,
        log_depths: Float[Tensor, "batch view height width"],
        log_confidences: Float[Tensor, "batch view height width"],
        features: Float[Tensor, "batch view patch channel"],
        quarter: Float[Tensor, "image quarter_channel row column"],
    ) -> tuple[Float[Tensor, "batch view height width"], Float[Tensor, "batch view height width"]]:
        """What to add to log_depths and to log_confidences."""
        rows, columns = quarter.shape[-2:]
        picture = torch.cat(
            [
                _evidence_picture(evidence).unflatten(-1, (rows, columns)),
                functional.avg_pool2d(log_depths.flatten(0, 1)[:, None], MATCH_STRIDE),
                functional.avg_pool2d(log_confidences.flatten(0, 1)[:, None], MATCH_STRIDE) * 0.5,
            ],
            dim=1,
        )
        fine = self.look(torch.cat([picture.to(quarter.dtype), quarter], dim=1))
        tokens = self.gather(fine).flatten(2).mT + self.describe(features.flatten(0, 1))
        for block in self.blocks:
            tokens = block(tokens)
        coarse = self.spread(self.norm(tokens)).mT.unflatten(2, (rows // 2, columns // 2))
        mixed = self.mix(functional.pixel_shuffle(coarse, 2) + self.keep(fine))
        change = functional.interpolate(
            self.correct(mixed).float(),
            scale_factor=MATCH_STRIDE,
            mode="bilinear",
            align_corners=False,
        ).unflatten(0, log_depths.shape[:2])
        return change[:, :, 0], change[:, :, 1]


def _evidence_picture(evidence: ParallaxEvidence) -> Float[Tensor, "image 5 cell"]:
    """The evidence in numbers of about one."""
    weights = evidence.weights * TYPICAL_DEVIATION**2
    worth = weights / (weights + 1)
    channels = [
        3 * worth * evidence.residuals,
        evidence.residuals,
        (0.25 * (weights + 1e-4).log() + 0.35) * evidence.matched,
        evidence.trust,
        (20 * evidence.misses).clamp_max(2),
    ]
    return torch.stack(channels, dim=2).flatten(0, 1)
