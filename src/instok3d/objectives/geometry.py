"""Training losses of the nano backbone: depth up to scale, matches, focal length."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.backbones.nano.backbone import NanoBackbone, RawGeometry
from instok3d.backbones.nano.matching import MATCH_STRIDE
from instok3d.geometry.cameras import invert_rigid, project, transform_points
from instok3d.types import Cameras, Views


@dataclass(frozen=True)
class DepthLoss:
    """The weighted sum and its parts, each a mean over the pixels of known depth."""

    total: Float[Tensor, ""]
    depth: Float[Tensor, ""]
    """Mean absolute error of log depth after one scale per scene: about the relative error."""
    scale: Float[Tensor, ""]
    """Absolute logarithm of that scale, for scenes normalised to mean depth 1."""
    gradient: Float[Tensor, ""]
    confidence: Float[Tensor, ""]


@dataclass(frozen=True)
class GeometryLoss(DepthLoss):
    """The weighted sum and its parts, each a mean over what it concerns."""

    match: Float[Tensor, ""]
    """Negative log-likelihood of the true matches, and of no match where there is none."""
    focal: Float[Tensor, ""]


def depth_loss(
    log_depths: Float[Tensor, "batch view height width"],
    log_confidences: Float[Tensor, "batch view height width"],
    true_depths: Float[Tensor, "batch view height width"],
) -> DepthLoss:
    """Compare predicted log depth with true depth, where that is known (> 0)."""
    known = true_depths > 0
    mean_depth = _masked_mean(true_depths, known).clamp_min(1e-6)[:, None, None, None]
    log_true = torch.where(known, true_depths / mean_depth, 1.0).log()
    unscaled = log_depths.float() - log_true
    error = unscaled - _median_where(unscaled.detach(), known)[:, None, None, None]
    depth = _mean_where(error.abs(), known)
    scale = _mean_where(unscaled, known).abs()
    spread = error.abs().detach() * log_confidences.exp() - log_confidences
    confidence = _mean_where(spread, known)
    gradient = _gradient_loss(error, known)
    total = depth + 0.1 * scale + 0.5 * gradient + 0.05 * confidence
    return DepthLoss(total, depth, scale, gradient, confidence)


def geometry_loss(backbone: NanoBackbone, raw: RawGeometry, true: Views) -> GeometryLoss:
    """Compare what the network said of the views with their true depth and cameras.

    Args:
        backbone: Gives the matching layer and the typical focal length.
        raw: Its output for these views.
        true: Intrinsics, cameras and depth of the views, all given; depth 0 is unknown.

    Raises:
        ValueError: A part of the truth is missing.
    """
    if true.depths is None or true.cam_from_world is None or true.intrinsics is None:
        raise ValueError("geometry_loss needs depths, cam_from_world and intrinsics of the views")
    depth = depth_loss(raw.log_depths, raw.log_confidences, true.depths)
    match = _match_loss(backbone, raw, true, Cameras(true.cam_from_world, true.intrinsics))
    width = max(true.images.shape[-2:])
    typical = 0.5 * width / torch.tan(torch.tensor(0.5 * backbone.config.typical_field_of_view_rad))
    focal = (raw.log_focal - (true.intrinsics[..., 0, 0] / typical).log()).abs().mean()
    total = depth.total + 0.1 * match + 0.3 * focal
    return GeometryLoss(
        total, depth.depth, depth.scale, depth.gradient, depth.confidence, match, focal
    )


def _median_where(values: Tensor, mask: Tensor) -> Float[Tensor, " batch"]:
    """Median over the masked values of each scene, 0 where there are none."""
    chosen = [scene[keep] for scene, keep in zip(values, mask, strict=True)]
    return torch.stack([v.median() if v.numel() else values.new_zeros(()) for v in chosen])


def _masked_mean(values: Tensor, mask: Tensor) -> Float[Tensor, " batch"]:
    total = (values * mask).flatten(1).sum(1)
    return total / mask.flatten(1).sum(1).clamp_min(1)


def _gradient_loss(error: Tensor, known: Tensor) -> Float[Tensor, ""]:
    """Differences of the error between neighbours 1, 2 and 4 pixels apart: shape before level."""
    total = error.sum() * 0
    for step in (1, 2, 4):
        across = known[..., step:] & known[..., :-step]
        down = known[..., step:, :] & known[..., :-step, :]
        x = (error[..., step:] - error[..., :-step]).abs().clamp_max(0.5)
        y = (error[..., step:, :] - error[..., :-step, :]).abs().clamp_max(0.5)
        total = total + _mean_where(x, across) + _mean_where(y, down)
    return total / 6


def _mean_where(values: Tensor, mask: Tensor) -> Float[Tensor, ""]:
    return (values * mask).sum() / mask.sum().clamp_min(1)


@dataclass(frozen=True)
class TrueMatches:
    """Where the chosen descriptor cells of one view lie in another."""

    pixels: Float[Tensor, "batch cell 2"]
    """In the other view's image; arbitrary where not visible."""
    visible: Bool[Tensor, "batch cell"]
    known: Bool[Tensor, "batch cell"]
    """False where the cell's own depth is unknown."""


def true_matches(
    depths_a: Float[Tensor, "batch height width"],
    intrinsics_a: Float[Tensor, "batch 3 3"],
    depths_b: Float[Tensor, "batch height width"],
    intrinsics_b: Float[Tensor, "batch 3 3"],
    b_from_a: Float[Tensor, "batch 4 4"],
    cells: Int[Tensor, " cell"],
) -> TrueMatches:
    """Cells of a projected into b by true depth; visible where b's own depth agrees to 5 %."""
    height, width = depths_a.shape[-2:]
    half = MATCH_STRIDE // 2
    columns = width // MATCH_STRIDE
    row, column = cells // columns * MATCH_STRIDE + half, cells % columns * MATCH_STRIDE + half
    depth = depths_a[:, row, column]
    # The centre of a cell is a corner of four pixels: the ray through it, not through a pixel.
    center = torch.stack([column, row, torch.ones_like(row)], dim=-1).to(depth)
    seen = transform_points(b_from_a, center @ intrinsics_a.inverse().mT * depth[..., None])
    in_front = seen[..., 2] > 0.05
    pixels = project(torch.where(in_front[..., None], seen, 1.0), intrinsics_b)
    x, y = pixels.floor().long().unbind(-1)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    surface = depths_b.flatten(1).gather(1, y.clamp(0, height - 1) * width + x.clamp(0, width - 1))
    agrees = (surface - seen[..., 2]).abs() < 0.05 * seen[..., 2]
    known = depth > 0
    return TrueMatches(pixels, known & in_front & inside & agrees & (surface > 0), known)


def _match_loss(
    backbone: NanoBackbone, raw: RawGeometry, true: Views, cameras: Cameras
) -> Float[Tensor, ""]:
    """Mean over ordered pairs of views at most two apart, on a quarter of the cells.

    The softmax over all cells of the other view is the cost; a fresh phase of a 2x2 lattice of
    query cells each time sees all of them in the long run.
    """
    assert true.depths is not None
    count = true.images.shape[1]
    rows, columns = (size // MATCH_STRIDE for size in true.images.shape[-2:])
    down, right = torch.randint(2, (2,)).tolist()
    lattice = torch.arange(rows * columns).view(rows, columns)[down::2, right::2].flatten()
    losses = []
    for a in range(count):
        for b in range(max(0, a - 2), min(count, a + 3)):
            if a == b:
                continue
            b_from_a = cameras.cam_from_world[:, b] @ invert_rigid(cameras.cam_from_world[:, a])
            matches = true_matches(
                true.depths[:, a], cameras.intrinsics[:, a],
                true.depths[:, b], cameras.intrinsics[:, b], b_from_a, lattice,
            )  # fmt: skip
            logits, total = backbone.match(raw.descriptors[:, a, lattice], raw.descriptors[:, b])
            unseen = backbone.no_match() - total
            losses.append(_match_nll(logits - total[..., None], unseen, matches, rows, columns))
    return torch.stack(losses).mean() if losses else raw.log_depths.sum() * 0


def _match_nll(
    log_match: Tensor, log_unseen: Tensor, true: TrueMatches, rows: int, columns: int
) -> Float[Tensor, ""]:
    """Cross-entropy of the matches against the true place, shared bilinearly by four cells."""
    place = true.pixels / MATCH_STRIDE - 0.5
    corner = place.floor()
    share = place - corner
    nll = torch.zeros_like(log_unseen)
    for down in (0, 1):
        for right in (0, 1):
            column = (corner[..., 0].long() + right).clamp(0, columns - 1)
            row = (corner[..., 1].long() + down).clamp(0, rows - 1)
            weight_x = share[..., 0] if right else 1 - share[..., 0]
            weight_y = share[..., 1] if down else 1 - share[..., 1]
            chosen = log_match.gather(-1, (row * columns + column)[..., None]).squeeze(-1)
            nll = nll - weight_x * weight_y * chosen
    hidden = true.known & ~true.visible
    return _mean_where(nll, true.visible) + 0.5 * _mean_where(-log_unseen, hidden)
