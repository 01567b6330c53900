"""A few unposed photos of a room in, a 3D scene made of objects out.

The public names are imported when they are first used, so that `instok3d --help` need not wait
for PyTorch.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from instok3d.scene.demo import demo
    from instok3d.scene.objects import SceneObject
    from instok3d.scene.reconstruct import load, reconstruct
    from instok3d.scene.refine import refine
    from instok3d.scene.scene import Scene

__version__ = "0.1.0"
__all__ = ["Scene", "SceneObject", "__version__", "demo", "load", "reconstruct", "refine"]

_HOMES = {
    "Scene": "instok3d.scene.scene",
    "SceneObject": "instok3d.scene.objects",
    "demo": "instok3d.scene.demo",
    "load": "instok3d.scene.reconstruct",
    "reconstruct": "instok3d.scene.reconstruct",
    "refine": "instok3d.scene.refine",
}


def __dir__() -> list[str]:
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'instok3d' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
