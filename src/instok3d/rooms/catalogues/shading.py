"""Normals of triangle meshes: smooth over gentle bends, sharp at edges."""

import numpy as np
from jaxtyping import Float, Int

CREASE_COSINE = np.cos(np.radians(40))
"""Faces that meet at a larger angle keep an edge between them."""
GRID_BITS = 18
"""Corners in one cell of this many bits a side of the mesh are one point."""
MOST_NEIGHBOURS = 32
"""Around points with more faces, such as the middle of a disc, all stay flat."""


def corner_normals(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "face 3 3"]:
    """Unit normals of every corner of every face.

    A corner's normal is the mean of the normals of those faces around its point that bend away
    by less than 40 degrees from its own face, weighted by area.

    Args:
        vertices: Positions, metres.
        faces: Without degenerate triangles.
    """
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = weighted / np.linalg.norm(weighted, axis=1, keepdims=True)
    point = _welded(corners.reshape(-1, 3))
    # 1. Corners sorted by point: those of a point are a run from `first`, `degree` long.
    order = np.argsort(point, kind="stable")
    degrees = np.bincount(point)
    first, degree = (np.cumsum(degrees) - degrees)[point], degrees[point]
    # 2. In step k every corner meets the k-th corner around its point.
    face = np.arange(len(point)) // 3
    total = weighted[face]
    mine = np.nonzero(degree <= MOST_NEIGHBOURS)[0]
    for step in range(MOST_NEIGHBOURS):
        mine = mine[degree[mine] > step]
        own, other = face[mine], face[order[first[mine] + step]]
        cosine = np.einsum("ij,ij->i", unit[own], unit[other])
        near = (cosine > CREASE_COSINE) & (other != own)
        total[mine[near]] += weighted[other[near]]
    total /= np.linalg.norm(total, axis=1, keepdims=True)
    return total.reshape(-1, 3, 3)


def _welded(corners: Float[np.ndarray, "corner 3"]) -> Int[np.ndarray, " corner"]:
    """The number of each corner's point; corners in one cell of a fine grid are one point."""
    if not len(corners):
        return np.zeros(0, np.int64)
    low, extent = corners.min(0), float(np.ptp(corners, axis=0).max())
    cells = np.rint((corners - low) / extent * 2**GRID_BITS).astype(np.int64)
    packed = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return np.unique(packed, return_inverse=True)[1]
