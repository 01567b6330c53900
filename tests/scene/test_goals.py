"""Where a robot could stand in an office of boxes: 4 x 3 m, a wall at y = 3, z up."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from box_room import MOTION, OFFICE, RED, Thing, box_room, with_cameras
from instok3d.geometry.moving import Similarity
from instok3d.scene.goals import Goal, find_goal
from instok3d.scene.scene import Scene


@pytest.fixture(scope="module")
def office() -> Scene:
    return box_room(OFFICE)


def gap_to(goal: Goal, thing: Thing) -> float:
    """Between the robot's rim and a box, seen from above."""
    spot = np.array(goal.position[:2])
    low, high = np.array(thing.low[:2]), np.array(thing.high[:2])
    return float(np.linalg.norm(np.maximum(np.maximum(low - spot, spot - high), 0))) - goal.radius


@pytest.mark.parametrize("name", ["desk", "chair", "cabinet", "box", "stool", "cup"])
def test_the_spot_is_free_near_and_faces_the_object(office: Scene, name: str):
    goal = find_goal(office, office.object(name))
    assert goal.radius == 0.25
    assert -0.05 <= gap_to(goal, OFFICE[name]) <= 4 * 0.25
    for other in ("desk", "chair", "cabinet", "box", "stool"):
        assert gap_to(goal, OFFICE[other]) > -0.05, other  # boxes reach one deviation farther
    x, y, z = goal.position
    assert 0.25 <= x <= 3.75
    assert 0.25 <= y <= 2.75
    assert z == pytest.approx(0, abs=0.08)  # on the floor
    facing = np.array(goal.facing)
    assert np.linalg.norm(facing) == pytest.approx(1)
    middle = (np.array(OFFICE[name].low) + OFFICE[name].high) / 2
    assert facing[2] == pytest.approx(0, abs=1e-6)
    assert facing[:2] @ (middle[:2] - goal.position[:2]) > 0


def test_it_stands_before_the_cabinet_by_hand(office: Scene):
    # The cabinet fills a corner; along its front the nearest row of cells is a radius away.
    goal = find_goal(office, office.object("cabinet"))
    assert goal.gap < 0.12
    assert abs(goal.facing[0]) + abs(goal.facing[1]) == pytest.approx(1, abs=1e-6)


def test_the_answer_moves_with_the_world(office: Scene):
    turned = find_goal(
        box_room(OFFICE, motion=MOTION), box_room(OFFICE, motion=MOTION).object("box"), 0.1
    )
    here = find_goal(office, office.object("box"), 0.25)
    assert turned.radius == 0.1  # 0.25 m in units of 2.5 m
    back = MOTION.rotation().T @ (
        torch.tensor(turned.position).double() - torch.tensor(MOTION.translation).double()
    )
    spot = replace(here, position=tuple((back / MOTION.scale).tolist()))
    assert gap_to(spot, OFFICE["box"]) == pytest.approx(here.gap, abs=0.15)
    assert spot.position[2] == pytest.approx(0, abs=0.1)


def test_without_a_known_unit_the_robot_is_a_share_of_the_room():
    room = box_room(OFFICE, motion=Similarity(scale=10.0))
    goal = find_goal(room, room.object("box"))
    assert goal.radius == pytest.approx(0.05 * 40, rel=0.05)


def test_no_spot_is_refused_with_what_to_do(office: Scene):
    with pytest.raises(ValueError, match=r"no free spot for a robot of radius 1\.4 is"):
        find_goal(office, office.object("desk"), 1.4)
    for radius in (0.0, -1.0, 5.0, 1e-4, float("nan")):
        with pytest.raises(ValueError, match="radius must be from"):
            find_goal(office, office.object("desk"), radius)
    with pytest.raises(ValueError, match="stool#8 is hidden"):
        find_goal(office.hide("stool"), office.hide("stool").object("stool"))
    alone = box_room({"ball": Thing((0.0, 0, 0), (1.0, 1, 1), RED)})
    with pytest.raises(ValueError, match="no free spot"):
        find_goal(alone, alone.object("ball"), 0.2)


def test_what_is_shut_off_is_reached_from_where_photos_were_taken():
    # A wall across the room: the box stands on the far side, the photos come from the near one.
    things = {**OFFICE, "partition": Thing((-0.1, 1.1, 0), (4.1, 1.2, 2.0), RED)}
    room = box_room(things)
    near = with_cameras(room, [(2.5, 0.5, 1.5), (2.0, 0.5, 1.5)], (2.0, 1.1, 0.5))
    far = with_cameras(room, [(2.5, 2.0, 1.5), (2.0, 1.8, 1.5)], (2.0, 3.0, 0.5))
    assert find_goal(near, near.object("partition")).position[1] < 1.1
    assert find_goal(far, far.object("partition")).position[1] > 1.2
    with pytest.raises(ValueError, match=r"no free spot .* of box#7"):
        find_goal(far, far.object("box"), 0.1)
