"""VGGT, written anew so that the published weights load and give the published numbers."""

from instok3d.backbones.vggt.backbone import VGGTBackbone
from instok3d.backbones.vggt.config import PAPER_VGGT, VGGTConfig
from instok3d.backbones.vggt.conversion import to_patch_16
from instok3d.backbones.vggt.network import VGGT, VGGTOutput
from instok3d.backbones.vggt.weights import load_vggt_weights

__all__ = [
    "PAPER_VGGT",
    "VGGT",
    "VGGTBackbone",
    "VGGTConfig",
    "VGGTOutput",
    "load_vggt_weights",
    "to_patch_16",
]
