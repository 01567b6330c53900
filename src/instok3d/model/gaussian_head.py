"""The Gaussian head: a two-layer MLP turns each anchor token into N_g Gaussians (Sec. 3.1)."""

from dataclasses import dataclass
from math import isqrt, log
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.model.anchors import gather_rows
from instok3d.types import Anchors, Context, Gaussians

MAX_EXPANSION = 3.0
NEIGHBOURS = 3


MAX_LENGTH = 1e6
"""No size of Gaussians is larger."""


@dataclass(frozen=True)
class GaussianHeadConfig:
    """What each anchor is decoded into. Lengths are in units of the scene's mean distance."""

    gaussians_per_anchor: int = 16
    """N_g; the paper has 32. With surface seeding a square number, at least 4."""
    seeding: Literal["surface", "anchor"] = "surface"
    """Initial positions. anchor: around the anchor, as in the paper. surface: Gaussian j at surface
    cell j of the anchor's patch, with the cell's colour (a deviation: a small model then need not
    learn to copy the photo)."""
    sh_degree: int = 1
    """0 to 3; the paper has 2."""
    hidden_factor: int = 2
    """Width of the hidden layer, in token widths."""
    offset_bound: float = 0.1
    """Anchor seeding: largest offset from the anchor along each axis. The paper's models have 0.1
    in metres."""
    offset_bound_footprints: float = 4.0
    """Surface seeding: largest offset from the cell along each axis, in cells of the patch."""
    initial_scale: float = 0.03
    """Anchor seeding: standard deviation of a Gaussian at the start."""
    initial_scale_footprints: float = 0.6
    """Surface seeding: standard deviation of a Gaussian at the start, in cells of the patch."""
    scale_max: float = 0.3
    """Largest standard deviation. The paper's models have 0.3 in metres."""

    def __post_init__(self):
        if not 0 <= self.sh_degree <= 3:
            raise ValueError(f"sh_degree must be 0, 1, 2 or 3, got {self.sh_degree}")
        if self.seeding not in ("surface", "anchor"):
            raise ValueError(f"seeding must be 'surface' or 'anchor', got {self.seeding!r}")
        for name in ("gaussians_per_anchor", "hidden_factor"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("initial_scale", "initial_scale_footprints", "scale_max"):
            if not 0 < getattr(self, name) <= MAX_LENGTH:
                raise ValueError(
                    f"{name} must be above 0 and at most {MAX_LENGTH:g}, got {getattr(self, name)}"
                )
        for name in ("offset_bound", "offset_bound_footprints"):
            if not 0 <= getattr(self, name) <= MAX_LENGTH:
                raise ValueError(
                    f"{name} must be from 0 to {MAX_LENGTH:g}, got {getattr(self, name)}"
                )
        side = isqrt(self.gaussians_per_anchor)
        if self.seeding == "surface" and (side < 2 or side**2 != self.gaussians_per_anchor):
            raise ValueError(
                "surface seeding places Gaussians on a square grid: gaussians_per_anchor must be "
                f"4, 9, 16, ..., got {self.gaussians_per_anchor}"
            )

    @property
    def cells_per_side(self) -> int:
        """Side of the grid of surface cells that a patch must bring."""
        return isqrt(self.gaussians_per_anchor) if self.seeding == "surface" else 1

    @property
    def coefficients(self) -> int:
        """Spherical harmonics of one colour channel."""
        return (self.sh_degree + 1) ** 2


class GaussianHead(nn.Module):
    """Anchors in, their Gaussians out, in units of the context's scale.

    Colours are raw spherical harmonics, opacities a sigmoid, quaternions normalised. Bands above
    the constant are damped by 1/8, 1/32, 1/128, so that view dependence comes late.
    """

    damping: Tensor

    def __init__(self, width: int, config: GaussianHeadConfig):
        super().__init__()
        self.config = config
        surface = config.seeding == "surface"
        shape_inputs = 3 * config.gaussians_per_anchor + 1 if surface else 0
        self.sizes = [3, 3, 4, 1, 3 * config.coefficients]
        hidden = config.hidden_factor * width
        self.hidden = nn.Sequential(nn.Linear(width + shape_inputs, hidden), nn.GELU())
        self.out = nn.Linear(hidden, config.gaussians_per_anchor * sum(self.sizes))
        damping = harmonic_damping(config.sh_degree)
        self.register_buffer("damping", damping[:, None], persistent=False)
        nn.init.normal_(self.out.weight, std=0.002 if surface else 0.02)
        bias = torch.zeros(config.gaussians_per_anchor, sum(self.sizes))
        if not surface:
            bias[:, :3].normal_(std=0.5)  # otherwise all Gaussians of an anchor start equal
        bias[:, 6] = 1.0
        bias[:, 10] = 1.0 if surface else -2.0
        with torch.no_grad():
            self.out.bias.copy_(bias.flatten())

    def forward(self, anchors: Anchors, context: Context) -> Gaussians:
        """Gaussians in anchor order. Everything after the MLP runs in float32."""
        if self.config.seeding == "surface":
            seeds = _surface_seeds(anchors, context)
            hidden = self.hidden(torch.cat([anchors.tokens, seeds.shape_inputs], dim=-1))
            raw = self.out(hidden)
            with torch.autocast(raw.device.type, enabled=False):
                return self._from_surface(seeds, raw.float())
        raw = self.out(self.hidden(anchors.tokens))
        with torch.autocast(raw.device.type, enabled=False):
            return self._from_anchor(anchors.positions, raw.float())

    def no_gaussians(self, anchors: Anchors, context: Context) -> Gaussians:
        """An empty set of Gaussians, in the form that `forward` gives."""
        none = context.positions.new_zeros(len(anchors.tokens), 0, 1, 1)
        return self._gaussians(
            none.expand(-1, -1, -1, 3),
            none.expand(-1, -1, -1, 3),
            none.expand(-1, -1, -1, 4),
            none[..., 0],
            none[..., None].expand(-1, -1, -1, self.config.coefficients, 3),
        )

    def _from_surface(
        self, seeds: "_SurfaceSeeds", raw: Float[Tensor, "batch anchor number"]
    ) -> Gaussians:
        offsets, scales, quats, opacities, sh = self._split(raw)
        bound = self.config.offset_bound_footprints * seeds.spacing[..., None, None]
        means = seeds.points + bound * torch.tanh(offsets)
        start = self.config.initial_scale_footprints * seeds.spacing[..., None, None]
        constant = (seeds.colors - 0.5) / SH_CONSTANT
        sh = torch.cat([sh[..., :1, :] + constant[..., None, :], sh[..., 1:, :]], dim=-2)
        return self._gaussians(means, start.log() + scales, quats, opacities, sh)

    def _from_anchor(
        self,
        positions: Float[Tensor, "batch anchor 3"],
        raw: Float[Tensor, "batch anchor number"],
    ) -> Gaussians:
        offsets, scales, quats, opacities, sh = self._split(raw)
        means = positions[:, :, None] + self.config.offset_bound * torch.tanh(offsets)
        return self._gaussians(means, log(self.config.initial_scale) + scales, quats, opacities, sh)

    def _split(self, raw: Float[Tensor, "batch anchor number"]) -> list[Tensor]:
        each = raw.unflatten(-1, (self.config.gaussians_per_anchor, sum(self.sizes)))
        offsets, scales, quats, opacities, sh = each.split(self.sizes, dim=-1)
        sh = sh.unflatten(-1, (self.config.coefficients, 3)) * self.damping
        return [offsets, scales, quats, opacities.squeeze(-1), sh]

    def _gaussians(
        self,
        means: Float[Tensor, "batch anchor each 3"],
        log_scales: Float[Tensor, "batch anchor each 3"],
        quats: Float[Tensor, "batch anchor each 4"],
        opacities: Float[Tensor, "batch anchor each"],
        sh: Float[Tensor, "batch anchor each coefficient 3"],
    ) -> Gaussians:
        batch, anchors, each = opacities.shape
        index = torch.arange(anchors, device=means.device).repeat_interleave(each)
        return Gaussians(
            means=means.flatten(1, 2),
            quats=functional.normalize(quats, dim=-1).flatten(1, 2),
            # The cap has no gradient, as in the paper's models; clamping the logarithm first
            # keeps exp finite.
            scales=log_scales.clamp(-16.0, log(self.config.scale_max)).exp().flatten(1, 2),
            opacities=torch.sigmoid(opacities).flatten(1, 2),
            sh=sh.flatten(1, 2),
            anchor_index=index.expand(batch, -1),
        )


def harmonic_damping(sh_degree: int) -> Float[Tensor, " coefficient"]:
    """Factor of each coefficient: 1 for the constant, 0.5 * 4^-band for the others."""
    bands = [degree for degree in range(sh_degree + 1) for _ in range(2 * degree + 1)]
    return torch.tensor([0.5 * 0.25**band if band else 1.0 for band in bands])


@dataclass(frozen=True)
class _SurfaceSeeds:
    """Initial Gaussians of each anchor, and the head's inputs that describe them."""

    points: Float[Tensor, "batch anchor cell 3"]
    colors: Float[Tensor, "batch anchor cell 3"]
    spacing: Float[Tensor, "batch anchor"]
    shape_inputs: Float[Tensor, "batch anchor number"]


def _surface_seeds(anchors: Anchors, context: Context) -> _SurfaceSeeds:
    """The cells of each anchor's patch, expanded where anchors are sparse.

    With fewer anchors than patches (many views), each anchor must also cover the surface of
    patches that have none:

    1. Sparsity is the distance to the nearest anchors over the side of the patch.
    2. Cells move away from the anchor, and Gaussians grow, by the sparsity; at most by the number
       of patches per anchor and by MAX_EXPANSION.
    3. Colours move towards the patch's mean by the same factor: expanded detail would be wrong.
    """
    cells = gather_rows(context.cells, anchors.patches)
    points, colors = cells.split(3, dim=-1)
    spacing = _cell_spacing(points)
    apart = _neighbour_distance(anchors.positions)
    sparsity = apart / (spacing * isqrt(points.shape[2]))
    patches_per_anchor = context.cells.shape[1] / cells.shape[1]
    expansion = sparsity.clamp(1.0, min(patches_per_anchor, MAX_EXPANSION))[..., None, None]
    relative = points - anchors.positions[:, :, None]
    local = (relative / spacing[..., None, None]).clamp(-8.0, 8.0).flatten(2)
    shape_inputs = torch.cat([local, sparsity.clamp(0.05, 20.0).log()[..., None]], dim=-1)
    mean_color = colors.mean(dim=2, keepdim=True)
    return _SurfaceSeeds(
        points=anchors.positions[:, :, None] + expansion * relative,
        colors=mean_color + (colors - mean_color) / expansion,
        spacing=spacing * expansion[..., 0, 0],
        shape_inputs=shape_inputs,
    )


def _cell_spacing(points: Float[Tensor, "batch anchor cell 3"]) -> Float[Tensor, "batch anchor"]:
    """Side of a cell on a surface seen face on: a low quantile of the distances between neighbours.

    Low, because depth discontinuities and slanted surfaces can only increase these distances.
    """
    side = isqrt(points.shape[2])
    grid = points.unflatten(2, (side, side))
    down = (grid[:, :, 1:] - grid[:, :, :-1]).norm(dim=-1).flatten(2)
    right = (grid[:, :, :, 1:] - grid[:, :, :, :-1]).norm(dim=-1).flatten(2)
    distances = torch.cat([down, right], dim=-1)
    low = 1 + distances.shape[-1] // 8
    return distances.kthvalue(low, dim=-1).values.clamp_min(1e-5)


@torch.no_grad()
def _neighbour_distance(
    positions: Float[Tensor, "batch anchor 3"],
) -> Float[Tensor, "batch anchor"]:
    """Mean distance of each anchor to its NEIGHBOURS nearest anchors; 0 for a single anchor."""
    count = min(NEIGHBOURS, positions.shape[1] - 1)
    if count == 0:
        return torch.zeros_like(positions[..., 0])
    distance = torch.cdist(positions, positions)
    return distance.topk(count + 1, largest=False).values[..., 1:].mean(dim=-1)
