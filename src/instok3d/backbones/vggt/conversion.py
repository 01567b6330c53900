"""VGGT's weights for another patch size: 14 pixels in the published file, 16 in the paper."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.backbones.vggt.image_encoder import positions_for

ENCODER = "aggregator.patch_embed."
KERNEL = ENCODER + "patch_embed.proj.weight"
POSITIONS = ENCODER + "pos_embed"


def to_patch_16(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The published weights as the paper uses them: 256 x 256 images, patches of 16 (Sec. 4)."""
    return resize_patches(state, img_size=256, patch_size=16)


def resize_patches(
    state: Mapping[str, Tensor], *, img_size: int, patch_size: int
) -> dict[str, Tensor]:
    """VGGT's state dict for patches and position embedding of these sizes.

    Only two tensors change: the patch kernel by `resize_kernel`, and the position embedding,
    resized to the grid (bicubic), class token first. The dense heads keep their weights; they
    decode to the new patch size by interpolation.
    """
    side = img_size // patch_size
    changed = {
        KERNEL: resize_kernel(state[KERNEL], patch_size),
        POSITIONS: positions_for(state[POSITIONS], side, side),
    }
    return {**state, **changed}


def resize_kernel(
    kernel: Float[Tensor, "out in side side"], size: int
) -> Float[Tensor, "out in {size} {size}"]:
    """The patch kernel that answers to an enlarged patch as the old one did to the patch.

    With B the matrix of the bicubic, antialiased enlargement, the new kernel is pinv(B^T) times
    the old one (FlexiViT, arXiv 2212.08013), so <B x, new> = <x, old> for every patch x. For a
    smaller size, where no kernel does that, it is the nearest in least squares.
    """
    side = kernel.shape[-1]
    if side == size:
        return kernel
    pixels = torch.eye(side * side, dtype=torch.float64).unflatten(1, (1, side, side))
    enlarge = functional.interpolate(
        pixels, size=(size, size), mode="bicubic", antialias=True, align_corners=False
    ).flatten(1)  # B^T: a row for each old pixel
    solve = torch.linalg.pinv(enlarge).to(kernel.device)
    new = kernel.double().flatten(2) @ solve.mT
    return new.unflatten(2, (size, size)).to(kernel.dtype)
