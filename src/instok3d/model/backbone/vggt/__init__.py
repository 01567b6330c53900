"""VGGT, written anew so that the published weights load and give the published numbers."""

from instok3d.model.backbone.vggt.config import PAPER_VGGT, VGGTConfig
from instok3d.model.backbone.vggt.network import VGGT, VGGTOutput

__all__ = ["PAPER_VGGT", "VGGT", "VGGTConfig", "VGGTOutput"]
