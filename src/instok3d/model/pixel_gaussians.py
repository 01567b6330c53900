"""One Gaussian for every pixel, standing on the pointmap: the throw-away head of the adapt stage.

Rendering it at known cameras tells a geometry backbone in which units and in which frame its
pointmaps have to be (Sec. 4); the tokenizer has no use for it. With features of its own it is the
scene of LSM and Uni3R (`baselines.pixel_features`).
"""

from dataclasses import dataclass
from math import ceil, log2

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.base import GeometryBackbone
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.model.gaussian_head import harmonic_damping
from instok3d.types import Gaussians, Geometry, Views

INITIAL_SCALE_PIXELS = 0.6
"""Standard deviation of a Gaussian at the start, in pixels of its own view."""
INITIAL_OPACITY_LOGIT = 2.0
"""Nearly opaque, so that at the start renders show the photos and not the dark behind them."""
LARGEST_CHANGE = 4.0
"""The logarithm of a scale may leave its start by so much."""


@dataclass(frozen=True)
class PixelGaussianConfig:
    """Sizes of the pixel-aligned head."""

    width: int = 64
    """Channels; Uni3R's head has 256."""
    sh_degree: int = 2
    """0 to 3; of the paper's own Gaussians it is 2 (Sec. 4), of Uni3R's 3."""
    scale_max: float = 0.3
    """Largest standard deviation, scene units."""
    feature_channels: int = 0
    """Of a feature of each Gaussian beside its looks; Uni3R's head gives 64, the adapt stage 0."""


@dataclass(frozen=True)
class PixelScene:
    """Views as Gaussians, with the geometry that they stand on."""

    gaussians: Gaussians
    """One for each pixel of every view, row-major, view 0 first; scene units, first camera."""
    geometry: Geometry


class PixelGaussians(nn.Module):
    """A geometry backbone with the auxiliary head."""

    def __init__(self, backbone: GeometryBackbone, config: PixelGaussianConfig) -> None:
        super().__init__()
        self.backbone = backbone
        self.head = PixelGaussianHead(backbone.feature_channels, backbone.patch_size, config)

    def forward(self, views: Views) -> PixelScene:
        """Gaussians of every pixel; differentiable in the pointmaps, which are their means."""
        geometry = self.backbone(views)
        return PixelScene(self.head(views, geometry), geometry)


class PixelGaussianHead(nn.Module):
    """Features become scales, rotations, opacities and colours of a Gaussian for every pixel.

    Patch features are brought to half the image size by doublings with a convolution each, then
    to the image, which is added through a convolution of its own, as in Uni3R's head. Colours
    start as the pixels', sizes as the pixels' own.
    """

    damping: Tensor

    def __init__(self, feature_channels: int, patch_size: int, config: PixelGaussianConfig) -> None:
        super().__init__()
        self.config = config
        self.patch_size = patch_size
        width, coefficients = config.width, (config.sh_degree + 1) ** 2
        self.project = nn.Sequential(
            nn.LayerNorm(feature_channels), nn.Linear(feature_channels, width)
        )
        doublings = max(0, ceil(log2(patch_size)) - 1)
        self.enlarge = nn.ModuleList(
            nn.Conv2d(width, width, 3, padding=1) for _ in range(doublings)
        )
        self.from_image = nn.Conv2d(3, width, 7, padding=3)
        self.mix = nn.Conv2d(width, width, 3, padding=1)
        self.sizes = [3, 4, 1, 3 * coefficients, config.feature_channels]
        self.out = nn.Conv2d(width, sum(self.sizes), 1)
        damping = harmonic_damping(config.sh_degree)
        self.register_buffer("damping", damping[:, None], persistent=False)
        nn.init.normal_(self.out.weight, std=0.002)
        start = torch.zeros(sum(self.sizes))
        start[3] = 1.0  # no rotation
        start[7] = INITIAL_OPACITY_LOGIT
        self.out.bias = nn.Parameter(start)

    def forward(self, views: Views, geometry: Geometry) -> Gaussians:
        """Gaussians in float32; pixels whose point is not finite get one that cannot be seen.

        Raises:
            ValueError: The image size is no multiple of the patch size.
        """
        return self.with_features(views, geometry)[0]

    def with_features(
        self, views: Views, geometry: Geometry
    ) -> tuple[Gaussians, Float[Tensor, "batch pixel feature"]]:
        """The same Gaussians and their features, of as many channels as the config says.

        Raises:
            ValueError: See `forward`.
        """
        batch, count, _, height, width = views.images.shape
        rows, columns = height // self.patch_size, width // self.patch_size
        if geometry.features.shape[2] != rows * columns or height % self.patch_size:
            raise ValueError(
                f"images of {height} x {width} pixels do not give {geometry.features.shape[2]} "
                f"patches of {self.patch_size} pixels"
            )
        tokens = self.project(geometry.features.flatten(0, 1))
        maps = tokens.mT.unflatten(2, (rows, columns))
        for convolution in self.enlarge:
            maps = functional.interpolate(maps, scale_factor=2, mode="bilinear")
            maps = functional.gelu(convolution(maps))
        maps = functional.interpolate(maps, size=(height, width), mode="bilinear")
        images = views.images.flatten(0, 1)
        maps = functional.gelu(maps + self.from_image(2 * images - 1))
        raw = self.out(functional.gelu(self.mix(maps)))
        with torch.autocast(raw.device.type, enabled=False):
            pixels = (
                raw.float()
                .permute(0, 2, 3, 1)
                .reshape(batch, count * height * width, sum(self.sizes))
            )
            *looks, features = pixels.split(self.sizes, dim=-1)
            return self._gaussians(views, geometry, looks), features

    def _gaussians(self, views: Views, geometry: Geometry, looks: list[Tensor]) -> Gaussians:
        scales, quats, opacities, sh = looks
        points = geometry.pointmaps.float().flatten(1, 3)
        known = points.isfinite().all(dim=-1)
        points = torch.where(known[..., None], points, torch.zeros_like(points))
        start = (INITIAL_SCALE_PIXELS * self._pixel_sizes(points, geometry)).clamp_min(1e-5)
        change = LARGEST_CHANGE * torch.tanh(scales / LARGEST_CHANGE)
        sh = sh.unflatten(-1, (-1, 3)) * self.damping
        colors = views.images.permute(0, 1, 3, 4, 2).float().flatten(1, 3)
        constant = sh[..., :1, :] + ((colors - 0.5) / SH_CONSTANT)[..., None, :]
        return Gaussians(
            means=points,
            quats=functional.normalize(quats, dim=-1),
            scales=(start[..., None] * change.exp()).clamp_max(self.config.scale_max),
            opacities=torch.sigmoid(opacities[..., 0]) * known,
            sh=torch.cat([constant, sh[..., 1:, :]], dim=-2),
            anchor_index=torch.zeros_like(known, dtype=torch.long),
        )

    @torch.no_grad()
    def _pixel_sizes(
        self, points: Float[Tensor, "batch pixel 3"], geometry: Geometry
    ) -> Float[Tensor, "batch pixel"]:
        """About what a pixel covers where its point lies, scene units.

        By the distance from the first camera, since depths may come from another head than
        pointmaps, in other units.
        """
        focal = geometry.cameras.intrinsics[..., 0, 0].float()
        per_view = points.norm(dim=-1).unflatten(1, (focal.shape[1], -1))
        return (per_view / focal[..., None]).flatten(1)
