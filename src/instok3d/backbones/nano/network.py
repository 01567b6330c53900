"""The network of the nano backbone: everything that is learned.

Convolutional stem, alternating frame and global attention as in VGGT (Sec. 3.1 of the paper), and
heads for depth, confidence, focal length and dense descriptors.
"""

from dataclasses import dataclass
from math import pi

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.base import BackboneConfig, GeometryBackbone
from instok3d.backbones.nano.layers import SelfAttentionBlock, Stem, Unshuffle
from instok3d.backbones.nano.refinement import DepthRefinement
from instok3d.geometry.cameras import pixel_centers, pixel_rays
from instok3d.types import Views

QUARTER_CHANNELS = 64
"""Channels of the decoder's features at a quarter of the image's size."""


@dataclass(frozen=True)
class NanoConfig(BackboneConfig):
    """Sizes of the nano backbone."""

    width: int = 256
    """Channels of a token."""
    layers: int = 4
    """Pairs of a frame block and a global block (VGGT: 24)."""
    head_width: int = 64
    """Channels of an attention head; 32 is twice as slow on a CPU."""
    match_channels: int = 64
    """Channels of a descriptor."""
    refinement_layers: int = 2
    """Attention blocks of the refinement of depth by parallax; 0: no refinement."""
    typical_field_of_view_rad: float = 1.05
    """Field of view assumed where intrinsics are unknown, before the focal head corrects it."""

    def __post_init__(self) -> None:
        for name in ("width", "layers", "head_width", "match_channels"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.refinement_layers < 0:
            raise ValueError(f"refinement_layers must be at least 0, got {self.refinement_layers}")
        if not 0 < self.typical_field_of_view_rad < pi:
            raise ValueError(
                "typical_field_of_view_rad must be above 0 and below pi, got "
                f"{self.typical_field_of_view_rad}"
            )


@dataclass(frozen=True)
class RawGeometry:
    """Output of the network, before cameras are solved for; the input of the losses."""

    features: Float[Tensor, "batch view patch channel"]
    log_depths: Float[Tensor, "batch view height width"]
    log_confidences: Float[Tensor, "batch view height width"]
    descriptors: Float[Tensor, "batch view cell match_channel"]
    """Unit length; one per cell of MATCH_STRIDE x MATCH_STRIDE pixels, row-major."""
    log_focal: Float[Tensor, "batch view"]
    """Logarithm of predicted over typical focal length."""
    quarter: Float[Tensor, "image quarter_channel row column"]
    """Decoder features, one per cell; the views of all scenes are concatenated."""


class NanoNetwork(GeometryBackbone):
    """Encodes photos and scores matches between their descriptors; solves for nothing."""

    patch_size = 8

    def __init__(self, config: NanoConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.feature_channels = 2 * width
        self.stem = Stem(width)
        self.embed_position = nn.Linear(16, width)
        self.embed_ray = nn.Linear(2, width)
        self.unknown_ray = nn.Parameter(torch.zeros(width))
        self.frame_blocks = nn.ModuleList(
            SelfAttentionBlock(width, config.head_width) for _ in range(config.layers)
        )
        self.global_blocks = nn.ModuleList(
            SelfAttentionBlock(width, config.head_width) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(2 * width)
        self.to_coarse_depth = nn.Linear(2 * width, 2)
        self.to_quarter = Unshuffle(2 * width, 96, QUARTER_CHANNELS)
        self.to_half = Unshuffle(QUARTER_CHANNELS, 48, 32)
        self.to_fine_depth = nn.Conv2d(32, 8, 1)
        self.to_descriptor = nn.Conv2d(QUARTER_CHANNELS, config.match_channels, 1)
        self.log_sharpness = nn.Parameter(torch.tensor(2.5))
        self.no_match_cosine = nn.Parameter(torch.tensor(0.8))
        self.to_focal = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, 1))
        self.refinement = None
        if config.refinement_layers:
            self.refinement = DepthRefinement(
                width, config.head_width, config.refinement_layers, QUARTER_CHANNELS
            )
        nn.init.normal_(self.to_coarse_depth.weight, std=0.01)
        nn.init.normal_(self.to_fine_depth.weight, std=0.01)
        for parameter in self.to_focal[2].parameters():
            nn.init.zeros_(parameter)

    def encode(self, views: Views) -> RawGeometry:
        """Features, depth, descriptors and focal length of all views."""
        batch, count, _, height, width = views.images.shape
        if height % self.patch_size or width % self.patch_size:
            raise ValueError(
                f"images are {height}x{width} pixels; the nano backbone needs multiples of "
                f"{self.patch_size}: resize or pad them"
            )
        images = views.images.flatten(0, 1) * 2 - 1
        half, quarter, eighth = self.stem(images.contiguous(memory_format=torch.channels_last))
        rows, columns = eighth.shape[-2:]
        frame = tokens = eighth.flatten(2).mT + self._positions(views, rows, columns)
        for frame_block, global_block in zip(self.frame_blocks, self.global_blocks, strict=True):
            frame = frame_block(tokens)
            tokens = global_block(frame.view(batch, count * rows * columns, -1)).view_as(frame)
        features = self.norm(torch.cat([frame, tokens], dim=-1))
        grid = features.mT.unflatten(2, (rows, columns))
        quarter = self.to_quarter(grid, quarter)
        fine = functional.pixel_shuffle(self.to_fine_depth(self.to_half(quarter, half)), 2)
        coarse = self.to_coarse_depth(features).mT.unflatten(2, (rows, columns))
        coarse = functional.interpolate(
            coarse.float(), size=(height, width), mode="bilinear", align_corners=False
        )
        depth = coarse + fine.float()
        descriptors = self.to_descriptor(quarter).flatten(2).mT.float()
        split = (batch, count)
        return RawGeometry(
            features=features.unflatten(0, split),
            log_depths=depth[:, 0].clamp(-4, 4).unflatten(0, split),
            log_confidences=depth[:, 1].clamp(-4, 6).unflatten(0, split),
            descriptors=functional.normalize(descriptors, dim=-1).unflatten(0, split),
            log_focal=self.to_focal(features.mean(1)).float().squeeze(-1).unflatten(0, split),
            quarter=quarter,
        )

    def match(
        self,
        descriptors_a: Float[Tensor, "batch cell channel"],
        descriptors_b: Float[Tensor, "batch other channel"],
    ) -> tuple[Float[Tensor, "batch cell other"], Float[Tensor, "batch cell"]]:
        """Match logits of each cell of a against each cell of b, and the logarithm of their total.

        The total includes one more outcome, "not visible in b", with the logit no_match(). The
        match probabilities exp(logit - total) therefore sum to less than 1.
        """
        logits = descriptors_a @ descriptors_b.mT * self.log_sharpness.exp()
        return logits, torch.logaddexp(logits.logsumexp(dim=-1), self.no_match())

    def no_match(self) -> Float[Tensor, ""]:
        """Logit of "not visible": that of exp(4) cells whose cosine has a learned value."""
        return self.log_sharpness.exp() * self.no_match_cosine + 4.0

    def _positions(self, views: Views, rows: int, columns: int) -> Tensor:
        """Embedding of each patch's position in its image and, if known, of its viewing ray."""
        height, width = views.images.shape[-2:]
        centers = pixel_centers(rows, columns, like=views.images) * self.patch_size
        image_center = torch.tensor([0.5 * width, 0.5 * height], device=views.images.device)
        relative = (centers - image_center) / (0.5 * max(height, width))
        waves = [relative * (torch.pi / 2) * 2**octave for octave in range(4)]
        position = torch.cat([f(wave) for wave in waves for f in (torch.sin, torch.cos)], dim=-1)
        embedding = self.embed_position(position.flatten(0, 1))[None]
        if views.intrinsics is None:
            return embedding + self.unknown_ray
        scaled = views.intrinsics.flatten(0, 1).float().clone()
        scaled[:, :2] = scaled[:, :2] / self.patch_size
        rays = pixel_rays(scaled, rows, columns)[..., :2]
        return embedding + self.embed_ray(rays.flatten(1, 2))
