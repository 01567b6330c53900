"""Pictures of Gaussians: colour, coverage, depth and any per-anchor features, differentiable."""

from instok3d.render.api import render
from instok3d.render.settings import RasterSettings

__all__ = ["RasterSettings", "render"]
