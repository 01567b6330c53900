"""Refinement of depth by the parallax of matches in other views.

The network predicts depth from appearance. Once the cameras are solved, each match also gives a
depth of its cell by triangulation. How reliable that is depends on the parallax, on the match and
on its neighbours; a small network learns how far to correct the depth.
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
    Ways,
    matched_cells,
)
from instok3d.backbones.nano.threads import one_thread
from instok3d.geometry.cameras import invert_rigid

NEAREST = 0.05
"""Least depth of a point in front of a camera, in the network's units."""
TYPICAL_DEVIATION = 0.06
"""Standard deviation of predicted log depth. Evidence that is as precise enters the network with
half its weight."""


@dataclass(frozen=True)
class ParallaxEvidence:
    """Evidence on the depth of each cell from its matches, over all other views."""

    residuals: Float[Tensor, "batch view cell"]
    """Log-depth correction that brings the projections closest to the matches; weighted mean."""
    weights: Float[Tensor, "batch view cell"]
    """Sum over the matches of confidence times the precision of their correction."""
    confidence: Float[Tensor, "batch view cell"]
    """Largest confidence of its matches."""
    unexplained: Float[Tensor, "batch view cell"]
    """Reprojection error in x/z, y/z that no depth explains; weighted mean."""
    matched: Float[Tensor, "batch view cell"]
    """1 in views that were matched with another view, else 0."""


@one_thread()
@torch.no_grad()
def gather_evidence(
    pairs: list[PairMatches], views: PhotoViews, cam_from_first: Float[Tensor, "batch view 4 4"]
) -> ParallaxEvidence:
    """Evidence on each view's depth from all pairs; not differentiable.

    Args:
        pairs: Matches of all cells.
        views: With the depths to be corrected.
        cam_from_first: The solved cameras, in units of the depths.
    """
    batch, count, height, width = views.depths.shape
    scenes = torch.arange(batch, device=views.depths.device)
    cells = (height // MATCH_STRIDE) * (width // MATCH_STRIDE)
    residuals, weights, confidence, unexplained, matched = views.depths.new_zeros(
        5, batch, count, cells
    )
    cameras = cam_from_first.to(views.depths)
    for pair in pairs:
        both = matched_cells(Ways.of([pair], batch), views).split(2)
        for (here, there, _), way in zip(pair.ways, both, strict=True):
            there_from_here = cameras[scenes, there] @ invert_rigid(cameras[scenes, here])
            residual, weight, unexplained_here = measure_parallax(way, there_from_here)
            residuals[scenes, here] += residual * weight
            unexplained[scenes, here] += unexplained_here * weight
            weights[scenes, here] += weight
            confidence[scenes, here] = torch.maximum(confidence[scenes, here], way.confidence)
            matched[scenes, here] = 1.0
    total = weights.clamp_min(1e-9)
    return ParallaxEvidence(residuals / total, weights, confidence, unexplained / total, matched)


def measure_parallax(
    way: MatchedCells, other_from_here: Float[Tensor, "batch 4 4"]
) -> tuple[Float[Tensor, "batch cell"], Float[Tensor, "batch cell"], Float[Tensor, "batch cell"]]:
    """(residual, weight, unexplained error) of each cell by its match in one other view.

    The residual is one Gauss-Newton step in log depth on the reprojection error, weighted by the
    precision of the match. The unexplained error is what that step leaves, in x/z, y/z.
    """
    rotated = way.points @ other_from_here[:, :3, :3].mT
    seen = rotated + other_from_here[:, None, :3, 3]
    depth = seen[..., 2:].clamp_min(NEAREST)
    projected = seen[..., :2] / depth
    # Derivative of the projection by the log depth.
    parallax = (rotated[..., :2] - projected * rotated[..., 2:]) / depth
    error = way.rays - projected
    precise = (way.precision @ parallax[..., None])[..., 0]
    precision = (parallax * precise).sum(-1)
    residual = (precise * error).sum(-1) / precision.clamp_min(1e-9)
    unexplained_here = (error - parallax * residual[..., None]).norm(dim=-1)
    weight = way.confidence * precision * (seen[..., 2] > NEAREST)
    return residual.clamp(-1, 1), weight, unexplained_here.clamp_max(1)


class DepthRefinement(nn.Module):
    """Corrections of log depth and log confidence from the evidence and the views' features.

    The last layer is initialised with zeros: before training, nothing is corrected.
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
        """Corrections to add to log_depths and to log_confidences."""
        rows, columns = quarter.shape[-2:]
        inputs = torch.cat(
            [
                _evidence_channels(evidence).unflatten(-1, (rows, columns)),
                functional.avg_pool2d(log_depths.flatten(0, 1)[:, None], MATCH_STRIDE),
                functional.avg_pool2d(log_confidences.flatten(0, 1)[:, None], MATCH_STRIDE) * 0.5,
            ],
            dim=1,
        )
        fine = self.look(torch.cat([inputs.to(quarter.dtype), quarter], dim=1))
        tokens = self.gather(fine).flatten(2).mT + self.describe(features.flatten(0, 1))
        for block in self.blocks:
            tokens = block(tokens)
        coarse = self.spread(self.norm(tokens)).mT.unflatten(2, (rows // 2, columns // 2))
        mixed = self.mix(functional.pixel_shuffle(coarse, 2) + self.keep(fine))
        corrections = functional.interpolate(
            self.correct(mixed).float(),
            scale_factor=MATCH_STRIDE,
            mode="bilinear",
            align_corners=False,
        ).unflatten(0, log_depths.shape[:2])
        return corrections[:, :, 0], corrections[:, :, 1]


def _evidence_channels(evidence: ParallaxEvidence) -> Float[Tensor, "image 5 cell"]:
    """The evidence as channels with values of order one."""
    weights = evidence.weights * TYPICAL_DEVIATION**2
    reliability = weights / (weights + 1)
    channels = [
        3 * reliability * evidence.residuals,
        evidence.residuals,
        (0.25 * (weights + 1e-4).log() + 0.35) * evidence.matched,
        evidence.confidence,
        (20 * evidence.unexplained).clamp_max(2),
    ]
    return torch.stack(channels, dim=2).flatten(0, 1)
