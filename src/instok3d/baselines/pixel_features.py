"""LSM (Fan et al., NeurIPS 2024) and Uni3R (Sun et al., 2025): a Gaussian with a feature a pixel.

Written from the papers, on our backbone. Points are the backbone's, as in both. Uni3R's head gives
each Gaussian 64 channels, which a linear map brings to the encoder's space once they are rendered;
with as many channels as the encoder has, it is LSM without its compression. Features are learned
with the pictures, and move Gaussians as these do.
"""

from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor, nn

from instok3d.backbones.base import GeometryBackbone
from instok3d.baselines.feature_scene import FeatureScene, own_anchors
from instok3d.model.pixel_gaussians import PixelGaussianConfig, PixelGaussianHead
from instok3d.types import Geometry, Views


@dataclass(frozen=True)
class PixelFeatureConfig:
    """Sizes of the model beside its backbone."""

    head: PixelGaussianConfig = field(
        default_factory=lambda: PixelGaussianConfig(feature_channels=64)
    )
    encoder_channels: int = 256
    """D, of the 2D encoder; LSeg has 512."""

    def __post_init__(self) -> None:
        if self.head.feature_channels < 1:
            raise ValueError(
                f"head.feature_channels must be at least 1, got {self.head.feature_channels}"
            )
        if self.encoder_channels < 1:
            raise ValueError(f"encoder_channels must be at least 1, got {self.encoder_channels}")


class PixelFeatures(nn.Module):
    """Photos in, a Gaussian with a feature for every pixel out."""

    takes_features = False
    detaches_gaussians = False

    def __init__(self, backbone: GeometryBackbone, config: PixelFeatureConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = backbone
        self.head = PixelGaussianHead(backbone.feature_channels, backbone.patch_size, config.head)
        self.expand = nn.Linear(config.head.feature_channels, config.encoder_channels, bias=False)

    def forward(
        self,
        views: Views,
        encoded: Float[Tensor, "batch view feature row column"] | None = None,
        geometry: Geometry | None = None,
    ) -> FeatureScene:
        """See `FeatureModel`; what the encoder says of the photos does not matter."""
        seen: Geometry = self.backbone(views) if geometry is None else geometry
        gaussians, features = self.head.with_features(views, seen)
        return FeatureScene(own_anchors(gaussians), features, self.expand.weight, seen)
