"""Rooms before they are rendered: splits, held-out content, levels."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("embreex")

from instok3d.rooms import scene, textures
from instok3d.rooms.camera_path import PathFinder
from instok3d.rooms.levels import LEVEL_MIX, LEVELS, level_of
from instok3d.rooms.materials import HELD_OUT_MATERIALS
from instok3d.rooms.objects import HELD_OUT_GENERATORS, REGISTRY
from instok3d.rooms.plan import Box
from instok3d.rooms.rendering import Frame, Renderer
from instok3d.rooms.room import HELD_OUT_ROOM_TYPE, ROOM_TYPES, Room, build_room
from instok3d.rooms.seeding import SPLIT_STARTS, Streams, split_of

SEEDS = (11, 1_000_012, 2_000_013)


@pytest.fixture(scope="module")
def levels() -> dict[str, list[Room]]:
    """The same normal seeds, one of each split, in every level."""
    return {level: [build_room(seed, level) for seed in SEEDS] for level in LEVELS}


@pytest.fixture(scope="module")
def transfer() -> list[Room]:
    return [build_room(seed) for seed in range(3_000_000, 3_000_008)]


def kinds(room: Room) -> set[str]:
    return {material.kind for material in room.mesh.materials}


def generators(room: Room) -> set[str]:
    return {placed.generator for placed in room.plan.placed}


def test_a_split_has_a_million_seeds():
    for name, first in SPLIT_STARTS.items():
        assert split_of(first) == split_of(first + 999_999) == name
    for seed in (-1, 4_000_000):
        with pytest.raises(ValueError, match=f"seed {seed} is outside"):
            split_of(seed)


def test_normal_rooms_hold_nothing_that_is_held_out(levels):
    for room in [room for rooms in levels.values() for room in rooms]:
        assert not generators(room) & set(HELD_OUT_GENERATORS)
        assert not kinds(room) & set(HELD_OUT_MATERIALS)
        assert room.room_type in ROOM_TYPES


def test_transfer_rooms_hold_what_is_held_out(transfer):
    found = set().union(*map(generators, transfer))
    assert found & set(HELD_OUT_GENERATORS)
    assert set().union(*map(kinds, transfer)) & set(HELD_OUT_MATERIALS)
    assert {room.room_type for room in transfer} & {HELD_OUT_ROOM_TYPE}
    assert {room.room_type for room in transfer} & set(ROOM_TYPES)
    assert set(HELD_OUT_GENERATORS) <= set(REGISTRY)


def test_the_held_out_pattern_is_drawn_in_transfer_rooms_only(monkeypatch):
    drawn = []
    zigzag = textures.PATTERNS["zigzag"]
    spy = {"zigzag": lambda rng, count: drawn.append(count) or zigzag(rng, count)}
    monkeypatch.setattr(textures, "PATTERNS", textures.PATTERNS | spy)
    for seed, level in ((21, "hard"), (22, "hard"), (23, "real")):
        build_room(seed, level)
    assert not drawn
    for seed in (3_000_021, 3_000_022):
        build_room(seed, "hard")
    assert drawn


def test_level_and_room_type_follow_their_shares():
    # Of 1000 draws a share p deviates by sqrt(p (1 - p) / 1000) < 0.016: 4 deviations.
    drawn = [level_of(Streams(seed)).name for seed in range(1000)]
    for name, share in LEVEL_MIX.items():
        assert drawn.count(name) / 1000 == pytest.approx(share, abs=0.065)
    assert sum(ROOM_TYPES.values()) == pytest.approx(1)


def test_unknown_level_is_named():
    with pytest.raises(
        ValueError, match=r"level 'cosy' is unknown; choose mix, easy, medium, hard or real"
    ):
        build_room(1, "cosy")


def test_harder_rooms_hold_more(levels):
    count = {name: sum(len(r.plan.placed) for r in rooms) for name, rooms in levels.items()}
    on_top = {
        name: sum(p.parent > 0 for r in rooms for p in r.plan.placed)
        for name, rooms in levels.items()
    }
    assert count["easy"] < count["medium"] < count["hard"]
    assert on_top["easy"] < on_top["medium"] < on_top["hard"]


def test_field_of_view_varies_in_hard_rooms_only(levels):
    def angles(name: str) -> list[float]:
        found = []
        for seed, room in zip(SEEDS, levels[name], strict=True):
            streams = Streams(seed)
            renderer = Renderer(room, streams.child("lights"), None)
            found.append(PathFinder(room, renderer, streams.child("path")).fov_deg)
        return found

    assert angles("easy") == angles("medium") == [60.0] * len(SEEDS)
    hard = angles("hard")
    assert len(set(hard)) == len(SEEDS)
    assert all(55 <= angle <= 70 for angle in hard)


def test_exposure_and_sensor_differ_between_levels(levels):
    flat = Frame(np.full((16, 16, 3), 0.3, np.float32), np.ones((16, 16), np.float32),
                 np.ones((16, 16), np.uint16))  # fmt: skip
    light: dict[str, list[float]] = {}
    for name in ("easy", "hard"):
        for seed in range(12):
            room = dataclasses.replace(levels[name][0], seed=seed)
            images, _ = scene.developed_frames(room, [flat] * 4, Streams(seed), metered=[flat] * 4)
            light.setdefault(name, []).append(images.mean() / 255)
            same = (images[1:] == images[0]).all()
            assert same == (name == "easy")  # no drift and no noise in easy rooms
            assert (images[0].std((0, 1)).max() > 0) == (name == "hard")
    assert min(light["hard"]) < min(light["easy"]) - 0.05
    assert np.mean(light["hard"]) < np.mean(light["easy"])
    assert 0.35 < np.mean(light["easy"]) < 0.7


def test_rooms_are_lit(levels, transfer):
    for room in [room for rooms in levels.values() for room in rooms] + transfer:
        emission = np.array([m.emission for m in room.mesh.materials])
        assert (emission[room.mesh.face_material] > 0).any()


def test_a_room_without_any_light_is_rejected(levels, monkeypatch):
    room = levels["easy"][0]
    dark = tuple(dataclasses.replace(m, emission=0.0) for m in room.mesh.materials)
    dark_room = dataclasses.replace(room, mesh=dataclasses.replace(room.mesh, materials=dark))
    monkeypatch.setattr(scene, "build_room", lambda *_: dark_room)
    assert scene.render_scene(room.seed, 16, "easy") is None


def test_boxes_overlap_by_hand():
    square = Box(0, 0, 2, 2, 0, 0, 1)
    assert not square.overlaps(Box(2, 0, 2, 2, 0, 0, 1))  # they touch
    assert square.overlaps(Box(1.9, 0, 2, 2, 0, 0, 1))
    assert not square.overlaps(Box(1.9, 0, 2, 2, 0, 1, 2))  # one upon the other
    # A square of side 2 on its corner reaches sqrt(2) = 1.414 from its middle.
    assert square.overlaps(Box(2.4, 0, 2, 2, np.pi / 4, 0, 1))
    assert not square.overlaps(Box(2.42, 0, 2, 2, np.pi / 4, 0, 1))
    # Diagonally the corner squares are apart although their bounds overlap.
    assert not square.overlaps(Box(1.8, 1.8, 2, 2, np.pi / 4, 0, 1))
    assert square.distance(np.array([4.0, 5.0])) == pytest.approx(5)  # 3 right, 4 up
    assert square.distance(np.array([0.5, 0.0])) == pytest.approx(-0.5)
