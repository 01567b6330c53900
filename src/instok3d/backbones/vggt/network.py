"""VGGT as a bare network: images in, what its heads say out."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from instok3d.backbones.vggt.aggregator import Aggregator
from instok3d.backbones.vggt.camera_head import CameraHead
from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.dense_head import DenseHead


@dataclass(frozen=True)
class VGGTOutput:
    """Everything VGGT says of the views, in units of its own; the world is the first camera."""

    tokens: tuple[Float[Tensor, "batch view token channel"], ...]
    """After each pair of blocks: frame half, then global half; camera, registers, patches."""
    pose_enc: Float[Tensor, "batch view 9"]
    """Camera from world: translation, quaternion xyzw, fields of view (height, width) in rad."""
    world_points: Float[Tensor, "batch view height width 3"]
    """The point behind every pixel, in the first camera's frame."""
    world_points_conf: Float[Tensor, "batch view height width"]
    """> 1; larger is surer."""
    depth: Float[Tensor, "batch view height width 1"]
    """z-depth in each view's own camera."""
    depth_conf: Float[Tensor, "batch view height width"]
    """> 1; larger is surer."""


class VGGT(nn.Module):
    """Visual geometry grounded transformer (arXiv 2503.11651).

    Its state dict has the names and shapes of the published one, without `track_head.*`. The trunk
    may hold its weights in half the memory, `aggregator.to(torch.bfloat16)`, and the heads theirs
    in float32.
    """

    def __init__(self, config: VGGTConfig) -> None:
        super().__init__()
        self.config = config
        self.aggregator = Aggregator(config)
        self.camera_head = CameraHead(config)
        self.point_head = DenseHead(config, channels_out=4)
        self.depth_head = DenseHead(config, channels_out=2)

    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"] | None = None,
    ) -> VGGTOutput:
        """Run trunk and heads. The heads keep to the type of their weights under autocast.

        Args:
            images: sRGB in [0, 1]; sides are multiples of the patch size.
            intrinsics: Pixels; read by a network with the intrinsics token only.
        """
        size = images.shape[-2:]
        tokens = self.aggregator(images, intrinsics, layers=range(self.config.depth))
        points, points_conf = self.points(tokens, size)
        depth, depth_conf = self.depths(tokens, size)
        return VGGTOutput(
            tokens=tuple(tokens.values()),
            pose_enc=self.poses(tokens),
            world_points=points,
            world_points_conf=points_conf,
            depth=depth,
            depth_conf=depth_conf,
        )

    def poses(self, tokens: dict[int, Tensor]) -> Float[Tensor, "batch view 9"]:
        """The camera head's answer to the last pair's tokens."""
        last = tokens[self.config.depth - 1]
        with torch.autocast(last.device.type, enabled=False):
            return self.camera_head(last[:, :, 0].to(self.camera_head.token_norm.weight))

    def points(
        self, tokens: dict[int, Tensor], size: tuple[int, int] | torch.Size
    ) -> tuple[Float[Tensor, "batch view h w 3"], Float[Tensor, "batch view h w"]]:
        """World points and their confidences, from the point head."""
        raw = self._dense(self.point_head, tokens, size)
        offset = raw[..., :3]
        return offset.sign() * offset.abs().expm1(), 1 + raw[..., 3].exp()

    def depths(
        self, tokens: dict[int, Tensor], size: tuple[int, int] | torch.Size
    ) -> tuple[Float[Tensor, "batch view h w 1"], Float[Tensor, "batch view h w"]]:
        """Depths and their confidences, from the depth head."""
        raw = self._dense(self.depth_head, tokens, size)
        return raw[..., :1].exp(), 1 + raw[..., 1].exp()

    def patch_tokens(self, tokens: Tensor) -> Float[Tensor, "batch view patch channel"]:
        """One entry's tokens without camera and registers."""
        return tokens[:, :, self.aggregator.num_special_tokens :]

    def _dense(self, head: DenseHead, tokens: dict[int, Tensor], size: tuple[int, ...]) -> Tensor:
        rows, columns = (side // self.config.patch_size for side in size)
        chosen = [self.patch_tokens(tokens[layer]) for layer in self.config.dpt_layers]
        with torch.autocast(chosen[0].device.type, enabled=False):
            return head([each.to(head.norm.weight) for each in chosen], rows, columns)
