"""Normals that are smooth over gentle bends and sharp at edges."""

import numpy as np

from glb_files import CUBE, CUBE_FACES
from instok3d.rooms.catalogues.shading import corner_normals


def ring(sides: int) -> tuple[np.ndarray, np.ndarray]:
    """The side of an upright cylinder, every face with vertices of its own."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    above = circle + np.array([0, 0, 1])
    quads = np.stack([circle[:-1], circle[1:], above[1:], above[:-1]], 1)
    corners = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def test_a_cube_stays_flat():
    normals = corner_normals(CUBE.astype(float), CUBE_FACES.astype(np.int64))
    np.testing.assert_allclose(normals, np.repeat(normals[:, :1], 3, 1), atol=1e-12)
    np.testing.assert_allclose(np.abs(normals).max(-1), 1, atol=1e-12)


def test_a_cylinder_of_many_sides_is_round_though_its_faces_share_no_vertex():
    corners, faces = ring(24)
    radial = corners * [1, 1, 0]
    cosine = (corner_normals(corners, faces).reshape(-1, 3) * radial).sum(1)
    # A corner has three triangles, two of one side and one of the next: at most a sixth of the
    # 15 degrees between sides off the middle.
    assert cosine.min() > np.cos(np.radians(15 / 6 + 0.1))


def test_a_prism_of_six_sides_keeps_its_edges():
    corners, faces = ring(6)
    normals = corner_normals(corners, faces)
    np.testing.assert_allclose(normals, np.repeat(normals[:, :1], 3, 1), atol=1e-12)


def test_normals_do_not_depend_on_the_size_of_the_mesh():
    corners, faces = ring(24)
    small = corner_normals(corners * 0.01 + 3, faces)
    np.testing.assert_allclose(small, corner_normals(corners, faces), atol=1e-6)


def test_no_faces_have_no_normals():
    assert corner_normals(np.zeros((0, 3)), np.zeros((0, 3), np.int64)).shape == (0, 3, 3)
