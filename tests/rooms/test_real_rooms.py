"""Rooms of level `real`: what they hold, how they are lit and seen; other levels are untouched."""

import hashlib

import numpy as np
import pytest

pytest.importorskip("embreex")

from instok3d.rooms import colors
from instok3d.rooms.levels import LEVELS
from instok3d.rooms.lighting import Sun
from instok3d.rooms.materials import Material
from instok3d.rooms.rendering import Renderer, white_balance
from instok3d.rooms.room import Room, build_room
from instok3d.rooms.scene import RenderedScene, render_scene
from instok3d.rooms.seeding import Streams
from instok3d.rooms.sensor import LUMA, developed, exposure_for


@pytest.fixture(scope="module")
def room() -> Room:
    return build_room(207, "real")


@pytest.fixture(scope="module")
def scene() -> RenderedScene:
    found = render_scene(207, 32, "real")
    assert found is not None
    return found


def digest(room: Room) -> str:
    """Of what was placed where, and of which triangles and materials; rounded, as other kinds of
    processors come to slightly other numbers."""
    placed = []
    for p in room.plan.placed:
        lengths = (p.x, p.y, p.z, *p.furniture.size)
        numbers = [round(float(value), 3) + 0.0 for value in lengths]
        placed.append((p.generator, p.furniture.name, p.parent, *numbers))
    looks = [
        (m.kind, m.light, round(float(m.tile_m), 3), round(float(m.texture.mean())))
        for m in room.mesh.materials
    ]
    triangles = int(room.mesh.faces.sum()), int(room.mesh.face_material.sum())
    return hashlib.sha256(repr([placed, looks, triangles]).encode()).hexdigest()[:16]


@pytest.mark.parametrize(
    ("seed", "level", "expected"),
    [
        (21, "mix", "1b891b36fdc244ec"),
        (22, "easy", "b1b68ec29ecdaf7d"),
        (24, "medium", "95bc76c5994e9243"),
        (25, "hard", "ff229e52ddcf3279"),
        (3_000_005, "mix", "abc54dde92d9dcbd"),
    ],
)
def test_rooms_of_older_levels_stay_what_they_were(seed, level, expected):
    assert digest(build_room(seed, level)) == expected


def test_a_real_room_says_so_and_its_luma_is_one_of_photos(scene):
    assert scene.meta["level"] == "real"
    least, _, most = LEVELS["real"].mean_luma or (0, 0, 0)
    assert least - 0.03 < (scene.images @ LUMA).mean() / 255 < most + 0.03


def test_real_rooms_hold_far_more_small_things_than_hard_ones(room):
    def small(room: Room) -> int:
        return sum(max(p.furniture.size) < 0.5 for p in room.plan.placed)

    assert small(room) > 2 * small(build_room(room.seed, "hard"))


def test_things_lie_on_their_furniture_and_apart(room):
    boxes = room.plan.obstacles
    things = [i for i, p in enumerate(room.plan.placed, 1) if p.parent > 0]
    assert len(things) > 10
    for number, first in enumerate(things):
        placed = room.plan.placed[first - 1]
        parent = room.plan.placed[placed.parent - 1]
        assert any(placed.z == pytest.approx(parent.z + s.z) for s in parent.furniture.supports)
        for second in things[number + 1 :]:
            assert not boxes[first].overlaps(boxes[second])


def test_fields_of_view_of_photos():
    rng = np.random.default_rng(0)
    angles = np.array([LEVELS["real"].draw_fov_deg(rng) for _ in range(400)])
    assert 40 <= angles.min() < 50
    assert 80 < angles.max() <= 95
    assert 60 < np.median(angles) < 70


@pytest.mark.parametrize("wanted", [0.2, 0.36, 0.55])
@pytest.mark.parametrize("contrast", [0.0, 0.9])
def test_exposure_gives_the_luma_that_is_asked_for(wanted, contrast):
    radiance = np.random.default_rng(1).lognormal(-1, 1, (2, 16, 16, 3)).astype(np.float32)
    picture = developed(radiance, exposure_for(radiance, wanted, contrast), contrast)
    assert (picture @ LUMA).mean() / 255 == pytest.approx(wanted, abs=0.005)


def test_exposure_of_a_black_scene_is_finite():
    assert 0 < exposure_for(np.zeros((1, 4, 4, 3), np.float32), 0.4, 0.0) < 1e4


def test_contrast_keeps_black_white_and_the_middle():
    # The radiances that the tone curve without contrast takes to 0, 127 and 255.
    levels = np.linspace(0, 3, 3001, dtype=np.float32)
    flat = developed(np.repeat(levels[:, None], 3, 1)[None], 1.0)[0, :, 0]
    steep = developed(np.repeat(levels[:, None], 3, 1)[None], 1.0, 0.9)[0, :, 0].astype(int)
    assert steep[0] == 0
    assert steep[-1] == 255
    assert abs(int(steep[flat == 127][0]) - 127) <= 1
    assert (np.diff(steep) >= 0).all()
    assert steep[flat == 64].max() < 64


def test_white_balance_makes_its_light_white_or_leaves_some_of_its_tint(room):
    lamp = room.mesh.materials[0].texture.copy()
    lamp[:] = np.round(colors.light_color(2700) * 255)
    only = Material("glass", lamp, emission=1.0, light="lamp")
    lit = Room(1, room.level, "office", room.plan, room.mesh.__class__(
        **(vars(room.mesh) | {"materials": (only,)})
    ))  # fmt: skip
    light = (lamp[0, 0] / 255.0) ** 2.2
    tints = []
    for seed in range(20):
        shown = light * white_balance(lit, np.random.default_rng(seed))
        tints.append(np.log(shown[0] / shown[2]))
    assert np.log(light[0] / light[2]) > 2  # orange
    assert 0 < np.mean(tints) < 1  # corrected for the most part
    assert min(tints) < 0.4


def test_colours_of_black_bodies():
    candle, day, sky = (colors.light_color(k) for k in (2000, 6600, 12000))
    np.testing.assert_allclose(day, 1, atol=0.03)
    assert candle[0] == 1 > candle[1] > candle[2]
    assert sky[2] == 1 > sky[1] > sky[0]


def test_the_sun_shines_on_what_sees_it_through_a_window(room):
    renderer = Renderer(room, Streams(1).child("lights"), None)
    panes = [m.light == "window" for m in room.mesh.materials]
    faces = np.nonzero(np.array(panes)[room.mesh.face_material])[0]
    assert len(faces)
    corners = room.mesh.vertices[room.mesh.faces[faces[0]]]
    inwards = room.mesh.normals[room.mesh.faces[faces[0], 0]]
    point = corners.mean(0) + 0.05 * inwards
    points = np.array([point, point], np.float32)
    normals = np.array([-inwards, inwards], np.float32)  # towards the window, and away from it
    sun = Sun(-inwards, np.array([3, 2, 1], np.float32))
    light = renderer._sunlight(sun, points, normals)
    np.testing.assert_allclose(light[0], [3, 2, 1], rtol=1e-3)
    assert not light[1].any()
    above = Sun(np.array([0, 0, 1], np.float32), np.ones(3, np.float32))  # behind the ceiling
    assert not renderer._sunlight(above, points, np.array([[0, 0, 1], [0, 0, 1]], np.float32)).any()


def test_one_seed_gives_one_real_room(room):
    again = build_room(room.seed, "real")
    for name in ("vertices", "normals", "uvs", "faces", "face_material", "face_instance"):
        assert getattr(again.mesh, name).tobytes() == getattr(room.mesh, name).tobytes(), name
    for one, other in zip(again.mesh.materials, room.mesh.materials, strict=True):
        assert one.texture.tobytes() == other.texture.tobytes()
