"""Every furniture generator: finite, of the size it declares, with its surfaces facing outwards."""

import numpy as np
import pytest

from instok3d.rooms.classes import CLASSES
from instok3d.rooms.materials import Maker, Style
from instok3d.rooms.objects import REGISTRY, Furniture
from instok3d.rooms.primitives import Part, box, quad


def made(name: str, seed: int) -> Furniture:
    style = Style(plain=seed % 3 == 1, held_out=seed % 3 == 2)
    return REGISTRY[name](Maker(np.random.default_rng(seed), style))


def vector_areas(part: Part) -> np.ndarray:
    corners = part.vertices[part.faces]
    return 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def is_closed(part: Part) -> bool:
    """The vector area of a closed surface is 0 (a lathe's 0.1 mm hole on its axis is allowed)."""
    areas = vector_areas(part)
    return bool(np.linalg.norm(areas.sum(0)) < 1e-4 * np.linalg.norm(areas, axis=1).sum())


def signed_volume(part: Part) -> float:
    """By the divergence theorem; positive where the faces look outwards."""
    corners = part.vertices[part.faces] - part.vertices.mean(0)
    return float(np.linalg.det(corners).sum() / 6)


def test_volume_and_closedness_of_a_box_by_hand():
    material = made("cup", 0).parts[0].material
    solid = box((1, 2, 3), (1, 2, 3), material)
    assert is_closed(solid)
    assert signed_volume(solid) == pytest.approx(6)
    assert not is_closed(quad((0, 0, 0), (1, 0, 0), (0, 1, 0), material))


@pytest.mark.parametrize("name", ["cabinet", "refrigerator", "microwave", "suitcase"])
def test_furniture_of_boxes_and_cylinders_is_closed(name):
    assert all(is_closed(part) for part in made(name, 0).parts)


def test_there_are_87_generators():
    assert len(REGISTRY) == 87


@pytest.mark.parametrize("name", REGISTRY)
def test_geometry_is_finite_and_faces_outwards(name):
    for seed in range(3):
        for part in made(name, seed).parts:
            for values in (part.vertices, part.normals, part.uvs):
                assert np.isfinite(values).all()
            assert part.faces.min() >= 0
            assert part.faces.max() < len(part.vertices)
            areas = vector_areas(part)
            solid = np.linalg.norm(areas, axis=1) > 1e-9
            shading = part.normals[part.faces].sum(1)
            assert ((areas * shading).sum(1)[solid] > 0).all(), "shading and winding disagree"
            if is_closed(part):
                assert signed_volume(part) > 0, "inside out"


@pytest.mark.parametrize("name", REGISTRY)
def test_object_has_the_size_and_the_origin_that_it_declares(name):
    for seed in range(3):
        item = made(name, seed)
        vertices = np.concatenate([part.vertices for part in item.parts])
        low, high = vertices.min(0), vertices.max(0)
        np.testing.assert_allclose(high - low, item.size, atol=1e-9)
        assert (high - low > 0.005).all()
        assert (high - low < 3).all()
        # Origins: the middle of the footprint, of the back, or of the top.
        anchors = [(0.5, 0.5, 0.0), (0.5, 1.0, 0.5), (0.5, 0.5, 1.0)]
        assert any(np.allclose(low + (high - low) * a, 0, atol=1e-9) for a in anchors)
        assert item.name in CLASSES
        for support in item.supports:
            assert low[0] - 1e-6 <= support.x0 < support.x1 <= high[0] + 1e-6
            assert low[1] - 1e-6 <= support.y0 < support.y1 <= high[1] + 1e-6
            assert low[2] < support.z <= high[2] + 1e-6


def test_same_stream_same_object_and_another_stream_another():
    first, again, other = (made("chair", seed) for seed in (4, 4, 5))
    assert first.size == again.size != other.size
    for part, twin in zip(first.parts, again.parts, strict=True):
        assert part.vertices.tobytes() == twin.vertices.tobytes()
        assert part.material.texture.tobytes() == twin.material.texture.tobytes()
