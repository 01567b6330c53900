"""Context fusion: features, colours and 3D points of every patch become one token each (X)."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from instok3d.types import Context, Geometry, Views


class ContextFusion(nn.Module):
    """X = LN(Linear(LN(F)) + patchify(RGB) + patchify(P)), colours in [-1, 1].

    Pointmaps are divided by their mean distance first, so that rooms in metres and scenes of any
    other unit look alike to everything behind; with normalize_scale off they are taken as they
    are. Patchify is one linear layer over the pixels of a patch, which is a strided convolution,
    only faster on a CPU.
    """

    def __init__(
        self,
        feature_channels: int,
        width: int,
        *,
        patch_size: int,
        cells_per_side: int = 1,
        normalize_scale: bool = True,
    ):
        super().__init__()
        if patch_size % cells_per_side:
            raise ValueError(
                f"cells_per_side must divide patch_size={patch_size}, got {cells_per_side}"
            )
        self.patch_size = patch_size
        self.cells_per_side = cells_per_side
        self.normalize_scale = normalize_scale
        pixels = 3 * patch_size**2
        self.feature_proj = nn.Sequential(
            nn.LayerNorm(feature_channels), nn.Linear(feature_channels, width)
        )
        self.color_proj = nn.Linear(pixels, width)
        self.point_proj = nn.Linear(pixels, width)
        self.norm = nn.LayerNorm(width)

    def forward(self, views: Views, geometry: Geometry) -> Context:
        """One token for each patch of every view, with its place and its cells.

        Points that are not finite count as unknown: they are left out of every mean and are 0
        in the token.

        Raises:
            ValueError: The image size is no multiple of the patch size, or the features do not
                fit it.
        """
        _check_patches(views, geometry, self.patch_size)
        device = views.images.device.type
        with torch.autocast(device, enabled=False):
            pointmaps = geometry.pointmaps.float()
            known = pointmaps.isfinite().all(dim=-1, keepdim=True)
            pointmaps = torch.where(known, pointmaps, torch.zeros_like(pointmaps))
            scale = torch.ones(len(pointmaps), device=pointmaps.device)
            if self.normalize_scale:
                scale = _mean_distance(pointmaps, known)
                pointmaps = pointmaps / scale[:, None, None, None, None]
            points = to_patches(pointmaps, self.patch_size)  # batch patch row column xyz
            colors = to_patches(views.images.permute(0, 1, 3, 4, 2).float(), self.patch_size)
            known = to_patches(known, self.patch_size)
            # bfloat16 would round a point at distance 1 to 1/128, coarser than a pixel.
            from_points = self.point_proj(points.flatten(2))
            positions = _centers(points, known)
            cells = self._cells(points, colors, known)
        tokens = self.feature_proj(geometry.features).flatten(1, 2)
        tokens = tokens + self.color_proj((2 * colors - 1).flatten(2)) + from_points
        return Context(self.norm(tokens), positions, cells, scale)

    def _cells(
        self,
        points: Float[Tensor, "batch patch row column 3"],
        colors: Float[Tensor, "batch patch row column 3"],
        known: Bool[Tensor, "batch patch row column 1"],
    ) -> Float[Tensor, "batch patch cell 6"]:
        side = self.cells_per_side

        def cell_sums(x: Tensor) -> Tensor:
            x = x.unflatten(3, (side, -1)).unflatten(2, (side, -1))
            return x.sum(dim=3).sum(dim=4).flatten(2, 3)  # twice as fast as both at once

        count = cell_sums(known.float())
        fallback = _centers(points, known)[:, :, None]
        mean_points = torch.where(count > 0, cell_sums(points) / count.clamp_min(1), fallback)
        mean_colors = cell_sums(colors) * (side / self.patch_size) ** 2
        return torch.cat([mean_points, mean_colors], dim=-1)


def to_patches(
    maps: Tensor,
    patch_size: int,
) -> Tensor:
    """[batch view height width channel] cut into [batch patch row column channel].

    View 0 first, patches row-major within a view, rows and columns the pixels of a patch.
    """
    grid = maps.unflatten(3, (-1, patch_size)).unflatten(2, (-1, patch_size))
    return grid.transpose(3, 4).flatten(1, 3)


def _centers(
    points: Float[Tensor, "batch patch row column 3"],
    known: Bool[Tensor, "batch patch row column 1"],
) -> Float[Tensor, "batch patch 3"]:
    """P~: the point at pixel (p/2, p/2), or the mean of the known ones where it is unknown.

    The paper says "stride p"; the centre is chosen because pointmaps are worst at the border.
    """
    middle = points.shape[2] // 2
    mean = points.sum(dim=(2, 3)) / known.sum(dim=(2, 3)).clamp_min(1)
    return torch.where(known[:, :, middle, middle], points[:, :, middle, middle], mean)


def _mean_distance(
    pointmaps: Float[Tensor, "batch view height width 3"],
    known: Bool[Tensor, "batch view height width 1"],
) -> Float[Tensor, " batch"]:
    distance = pointmaps.norm(dim=-1).flatten(1).sum(dim=1)
    return (distance / known.flatten(1).sum(dim=1).clamp_min(1)).clamp_min(1e-6)


def _check_patches(views: Views, geometry: Geometry, patch_size: int) -> None:
    height, width = views.images.shape[-2:]
    if height % patch_size or width % patch_size:
        raise ValueError(
            f"image height and width must be multiples of the patch size {patch_size}, "
            f"got {height} x {width}; resize or pad the photos"
        )
    patches = (height // patch_size) * (width // patch_size)
    if geometry.features.shape[2] != patches:
        raise ValueError(
            f"images of {height} x {width} have {patches} patches of {patch_size} pixels, "
            f"but the backbone gave features for {geometry.features.shape[2]}"
        )
