"""Embree against a plain Moeller-Trumbore intersection, and what happens without Embree."""

import sys

import numpy as np
import pytest

from instok3d.rooms.tracing import EmbreeTracer, Tracer, check_embree


class PlainTracer:
    """Every ray against every triangle, in double precision."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        corners = vertices[faces].astype(np.float64)
        self.corner = corners[:, 0]
        self.first, self.second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]

    def all_hits(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, ...]:
        """u, v, distance of every ray (row) on every triangle (column); inf where it misses."""
        d = directions[:, None].astype(np.float64)
        across = np.cross(d, self.second)
        scale = 1 / (across * self.first).sum(-1)
        away = origins[:, None] - self.corner
        u = (away * across).sum(-1) * scale
        turned = np.cross(away, self.first)
        v = (d * turned).sum(-1) * scale
        t = (turned * self.second).sum(-1) * scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        return u, v, np.where(hit, t, np.inf)


@pytest.fixture(scope="module")
def soup() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """40 random triangles, and 600 rays of any length of direction."""
    rng = np.random.default_rng(0)
    middles = np.repeat(rng.uniform(-1, 1, (40, 3)), 3, axis=0)
    vertices = (middles + rng.normal(0, 0.4, (120, 3))).astype(np.float32)
    faces = rng.permutation(np.arange(120, dtype=np.int32).reshape(40, 3))
    origins = rng.uniform(-2, 2, (600, 3)).astype(np.float32)
    directions = (rng.uniform(-1, 1, (600, 3)) - origins).astype(np.float32)
    directions *= rng.uniform(0.2, 3, (600, 1)).astype(np.float32)
    return vertices, faces, origins, directions


def clear_of_edges(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rays whose every triangle is hit or missed by a margin, so that rounding decides nothing."""
    return (np.abs(np.stack([u, v, 1 - u - v])) > 1e-4).all((0, 2))


def test_embree_finds_the_hits_of_the_plain_tracer(soup):
    pytest.importorskip("embreex")
    vertices, faces, origins, directions = soup
    u, v, t = PlainTracer(vertices, faces).all_hits(origins, directions)
    face = np.where(np.isfinite(t.min(1)), t.argmin(1), -1)
    sure = clear_of_edges(u, v)
    assert sure.sum() > 500
    assert (face[sure] >= 0).sum() > 200
    assert (face[sure] < 0).sum() > 50

    tracer = EmbreeTracer(vertices, faces)
    assert isinstance(tracer, Tracer)
    hits = tracer.trace(origins, directions)
    np.testing.assert_array_equal(hits.face[sure], face[sure])
    hit = np.nonzero(sure & (face >= 0))[0]
    np.testing.assert_allclose(hits.distance[hit], t[hit, face[hit]], rtol=2e-4)
    np.testing.assert_allclose(hits.u[hit], u[hit, face[hit]], atol=2e-3)
    np.testing.assert_allclose(hits.v[hit], v[hit, face[hit]], atol=2e-3)


def test_occlusion_is_a_hit_nearer_than_the_distance(soup):
    pytest.importorskip("embreex")
    vertices, faces, origins, directions = soup
    u, v, t = PlainTracer(vertices, faces).all_hits(origins, directions)
    nearest = t.min(1)
    limits = np.random.default_rng(1).uniform(0.2, 4, len(origins)).astype(np.float32)
    sure = clear_of_edges(u, v) & (np.abs(nearest - limits) > 1e-3)
    blocked = EmbreeTracer(vertices, faces).occluded(origins, directions, limits)
    np.testing.assert_array_equal(blocked[sure], (nearest < limits)[sure])
    assert 50 < blocked[sure].sum() < sure.sum() - 50


def test_without_embree_the_error_says_what_to_install(monkeypatch):
    for name in ("embreex", "embreex.mesh_construction", "embreex.rtcore_scene"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError, match=r"embreex.*pip install 'instok3d\[rooms\]'"):
        check_embree()
    with pytest.raises(ModuleNotFoundError, match="embreex"):
        EmbreeTracer(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]]))
