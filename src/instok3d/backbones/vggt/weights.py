"""Reading the published weights of VGGT."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from instok3d.backbones.vggt.aggregator import new_intrinsics_layer
from instok3d.backbones.vggt.backbone import VGGTBackbone
from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.conversion import KERNEL, POSITIONS, resize_patches
from instok3d.reading import UNREADABLE, reason_of
from instok3d.weights.reading import FETCH_AGAIN, read_weights_file

NOT_READ = "track_head."
"""The published file tracks pixels, too; nothing here does."""


def load_vggt_weights(path: Path, config: VGGTConfig | None = None) -> VGGTBackbone:
    """A backbone with the published weights, in float32, in eval mode on the CPU.

    Every tensor of the file is read and must fit, except for the track head's, and the file must
    hold every tensor of the network, except for the intrinsics layer's, which starts anew (Kaiming,
    zero bias). Patches of another size than the file's are resized (`resize_patches`).

    Args:
        path: A safetensors file with the names of the public VGGT-1B.
        config: Sizes; the public model's for None, PAPER_VGGT for the paper's.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or holds other tensors than VGGT's of these sizes.
    """
    config = VGGTConfig() if config is None else config
    if not path.is_file():
        raise FileNotFoundError(f"no weights {path}; give the safetensors file of VGGT-1B")
    state, _ = read_weights_file(path, FETCH_AGAIN, wanted=lambda n: not n.startswith(NOT_READ))
    if not is_published(state):
        raise ValueError(f"{path} is no VGGT: it has no {KERNEL} or no {POSITIONS}")
    with torch.device("meta"):  # no memory and no time for weights that are replaced
        backbone = VGGTBackbone(config)
    try:
        backbone.vggt.load_state_dict(from_published(state, config), strict=True, assign=True)
    except UNREADABLE as error:
        raise ValueError(
            f"{path} does not hold VGGT's tensors of these sizes: {reason_of(error)}"
        ) from error
    return backbone.eval()


def is_published(state: Mapping[str, Tensor]) -> bool:
    """Whether these are weights under the names of the public VGGT-1B."""
    return KERNEL in state and POSITIONS in state


def from_published(state: Mapping[str, Tensor], config: VGGTConfig) -> dict[str, Tensor]:
    """The state dict of a `VGGT` of these sizes from published weights.

    Without the track head, with resized patches, and with a new intrinsics layer where the network
    has one and the weights do not.
    """
    kept = {name: value for name, value in state.items() if not name.startswith(NOT_READ)}
    if config.intrinsics_token:
        layer = new_intrinsics_layer(config.embed_dim).state_dict()
        kept = {f"aggregator.embed_intrinsics.{name}": v for name, v in layer.items()} | kept
    return resize_patches(kept, img_size=config.img_size, patch_size=config.patch_size)


def fill_from_published(backbone: VGGTBackbone, weights: Mapping[str, Tensor]) -> bool:
    """Put published weights into a backbone of any sizes of patch; False if these are none.

    Raises:
        RuntimeError: They are of other sizes.
    """
    if not is_published(weights):
        return False
    backbone.vggt.load_state_dict(from_published(weights, backbone.config))
    return True
