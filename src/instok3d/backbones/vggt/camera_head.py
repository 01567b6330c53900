"""The camera head of VGGT: a pose for each view, refined in a few rounds."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.layers import Block, Mlp
from instok3d.geometry.cameras import rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.types import Cameras

POSE_SIZE = 9
"""Translation (3), quaternion xyzw (4), vertical and horizontal field of view (2)."""
ROUNDS = 4
FIELD_OF_VIEW_RANGE_RAD = (0.05, 3.0)


class CameraHead(nn.Module):
    """The camera tokens of all views to their pose encodings."""

    def __init__(self, config: VGGTConfig) -> None:
        super().__init__()
        width = 2 * config.embed_dim
        self.token_norm = nn.LayerNorm(width)
        self.empty_pose_tokens = nn.Parameter(torch.zeros(1, 1, POSE_SIZE))
        self.embed_pose = nn.Linear(POSE_SIZE, width)
        self.poseLN_modulation = nn.Sequential(nn.SiLU(), nn.Linear(width, 3 * width))
        self.trunk = nn.Sequential(
            *(
                Block(width, config.num_heads, layer_scale=0.01)
                for _ in range(config.camera_trunk_depth)
            )
        )
        self.trunk_norm = nn.LayerNorm(width)
        self.pose_branch = Mlp(width, width // 2, POSE_SIZE)

    def forward(
        self, camera_tokens: Float[Tensor, "batch view channel"]
    ) -> Float[Tensor, "batch view 9"]:
        """Translation, quaternion xyzw (of any length) and fields of view (height, width; >= 0).

        Camera from world, in units of the network. As in the published code, a round takes the
        pose that it starts from as a number: the gradient is that of the last round's change, and
        none reaches `empty_pose_tokens`, which the first round alone reads.
        """
        tokens = self.token_norm(camera_tokens)
        plain = functional.layer_norm(tokens, tokens.shape[-1:], eps=1e-6)
        pose = torch.zeros_like(tokens[..., :POSE_SIZE])
        known = self.empty_pose_tokens.expand_as(pose)
        for _ in range(ROUNDS):
            shift, scale, gate = self.poseLN_modulation(self.embed_pose(known)).chunk(3, dim=-1)
            modulated = tokens + gate * (plain * (1 + scale) + shift)
            pose = pose.detach() + self.pose_branch(self.trunk_norm(self.trunk(modulated)))
            known = pose.detach()
        return torch.cat([pose[..., :7], pose[..., 7:].relu()], dim=-1)


def decode_cameras(
    pose_encoding: Float[Tensor, "batch view 9"], height: int, width: int
) -> Cameras:
    """Cameras of a pose encoding, for images of this size with the principal point in the middle.

    Fields of view outside 0.05 to 3 radians, which no lens has, count as the nearest of these.
    """
    translation, quaternion, fields = pose_encoding.float().split([3, 4, 2], dim=-1)
    x, y, z, w = quaternion.unbind(-1)
    rotation = quat_to_matrix(torch.stack([w, x, y, z], dim=-1))
    half_size = pose_encoding.new_tensor([height / 2, width / 2]).float()
    focal_y, focal_x = (half_size / (fields.clamp(*FIELD_OF_VIEW_RANGE_RAD) / 2).tan()).unbind(-1)
    zero, one = torch.zeros_like(focal_x), torch.ones_like(focal_x)
    rows = [
        torch.stack([focal_x, zero, one * (width / 2)], dim=-1),
        torch.stack([zero, focal_y, one * (height / 2)], dim=-1),
        torch.stack([zero, zero, one], dim=-1),
    ]
    return Cameras(rigid(rotation, translation), torch.stack(rows, dim=-2))
