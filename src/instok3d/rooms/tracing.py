"""The seam to a ray tracer: first hits and occlusion of a triangle mesh."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

Rays = Float[np.ndarray, "ray 3"]


@dataclass(frozen=True)
class Hits:
    """The first hit of every ray."""

    face: Int[np.ndarray, " ray"]
    """Face index, -1 where nothing was hit."""
    u: Float[np.ndarray, " ray"]
    """Barycentric weight of the face's second vertex."""
    v: Float[np.ndarray, " ray"]
    """Barycentric weight of the face's third vertex."""
    distance: Float[np.ndarray, " ray"]
    """In lengths of the ray's direction."""


@runtime_checkable
class Tracer(Protocol):
    """What the renderer needs of a ray tracer."""

    def trace(self, origins: Rays, directions: Rays) -> Hits:
        """First hits; directions need not be unit vectors."""
        ...

    def occluded(
        self, origins: Rays, directions: Rays, distances: Float[np.ndarray, " ray"]
    ) -> Bool[np.ndarray, " ray"]:
        """Whether anything lies nearer than the distance, in lengths of the direction."""
        ...


def check_embree() -> None:
    """Do nothing where rooms can be rendered.

    Raises:
        ModuleNotFoundError: The ray tracer is not installed, or its library does not load.
    """
    try:
        import embreex.mesh_construction
        import embreex.rtcore_scene  # noqa: F401
    except ImportError as error:
        raise ModuleNotFoundError(
            "rendering rooms needs the ray tracer embreex; install it with "
            "`pip install 'instok3d[rooms]'`"
        ) from error


class EmbreeTracer:
    """Embree through embreex, single precision."""

    def __init__(self, vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]):
        """Raises ModuleNotFoundError where embreex is not installed."""
        check_embree()
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        self._vertices = np.ascontiguousarray(vertices, np.float32)
        self._faces = np.ascontiguousarray(faces, np.int32)
        self._mesh = TriangleMesh(self._scene, self._vertices, self._faces)  # keeps no copy

    def trace(self, origins: Rays, directions: Rays) -> Hits:
        """First hits; directions need not be unit vectors."""
        found = self._scene.run(origins, directions, query="INTERSECT", output=True)
        return Hits(found["primID"], found["u"], found["v"], found["tfar"])

    def occluded(
        self, origins: Rays, directions: Rays, distances: Float[np.ndarray, " ray"]
    ) -> Bool[np.ndarray, " ray"]:
        """Whether anything lies nearer than the distance, in lengths of the direction."""
        return self._scene.run(origins, directions, dists=distances, query="OCCLUDED") >= 0
