"""Pictures of Gaussians: colour, coverage, depth and any per-anchor features, differentiable."""

from instok3d.render.api import Backend, backends, render
from instok3d.render.native_backend import NativeStatus, native_status
from instok3d.render.settings import RasterSettings

__all__ = ["Backend", "NativeStatus", "RasterSettings", "backends", "native_status", "render"]
