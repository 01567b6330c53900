"""Captures of rooms of boxes laid over each other."""

import math
from dataclasses import replace

import pytest
import torch

from box_room import BLUE, MOTION, OFFICE, RED, Thing, box_room
from instok3d.scene.changes.alignment import align, fit_similarity, on_surfaces
from instok3d.scene.changes.traits import Traits, traits_of, unlikeness
from instok3d.scene.scene import Scene

SHIFTS = {"floor": (0, 0, 0.9), "wall": (0.5, -2.0, 0), "desk": (1.5, -1.9, 0.4),
          "cup": (2, 0.4, 1.0), "chair": (2.4, 1.2, 1.2), "cabinet": (-3, -2, 0),
          "box": (-2, 1.5, 1.1), "stool": (0.2, 2.2, 1.9)}  # fmt: skip
"""To places where things look the same and nothing fits."""


def ups(first: Scene, second: Scene) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor(first.vertical.up), torch.tensor(second.vertical.up)


def test_a_similarity_is_found_from_its_points(rng: torch.Generator):
    points = torch.randn(2, 9, 3, generator=rng, dtype=torch.float64)
    moved = torch.stack([MOTION.points(each) for each in points])
    rotation, translation, scale = fit_similarity(points, moved, torch.ones(2, 9).double())
    assert scale.tolist() == pytest.approx([0.4, 0.4])
    torch.testing.assert_close(rotation, MOTION.rotation().expand(2, 3, 3), atol=1e-5, rtol=0)
    again = scale[:, None, None] * points @ rotation.mT + translation[:, None]
    torch.testing.assert_close(again, moved, atol=1e-5, rtol=0)


def test_points_without_weight_do_not_count(rng: torch.Generator):
    points = torch.randn(9, 3, generator=rng, dtype=torch.float64)
    moved, weights = MOTION.points(points), torch.ones(9).double()
    moved[0] += 5
    weights[0] = 0
    assert float(fit_similarity(points, moved, weights)[2]) == pytest.approx(0.4)


def test_another_capture_in_another_world_is_laid_over_the_first():
    first, second = box_room(OFFICE), box_room(OFFICE, seed=1, motion=MOTION)
    found = align(traits_of(first), traits_of(second), ups(first, second))
    corners = torch.tensor([[x, y, z] for x in (0.0, 4) for y in (0.0, 3) for z in (0.0, 2.5)])
    apart = found.second_from_first.points(corners) - MOTION.points(corners)
    assert float(apart.norm(dim=1).max()) < 0.4 * 0.05  # five centimetres of a room of four metres
    assert found.agreement > 0.8
    assert found.pairs == tuple((row, row) for row in range(len(OFFICE)))


def test_rooms_that_are_not_the_same_are_refused():
    def shifted(thing: Thing, by: tuple[float, float, float]) -> Thing:
        low, high = torch.tensor([thing.low, thing.high]) + torch.tensor(by)
        return Thing(tuple(low.tolist()), tuple(high.tolist()), thing.color)

    other = {name: shifted(thing, SHIFTS[name]) for name, thing in OFFICE.items()}
    first, second = box_room(OFFICE), box_room(other, seed=1)
    with pytest.raises(ValueError, match="no alignment of the two scenes can be trusted: "):
        align(traits_of(first), traits_of(second), ups(first, second))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_objects_are_refused(count: int):
    first, second = box_room(OFFICE), box_room(dict(list(OFFICE.items())[:count]))
    with pytest.raises(ValueError, match=f"share too few objects .* of 8 and {count} objects"):
        align(traits_of(first), traits_of(second), ups(first, second))


def test_unlikeness_is_by_colour_sides_and_embeddings():
    traits = traits_of(box_room(OFFICE))
    names = list(OFFICE)
    same = unlikeness(traits, traits, 1.0)
    assert float(same.diagonal().abs().max()) == 0
    assert float(same[names.index("chair"), names.index("stool")]) > 1
    # One and a half times as large: each side's logarithm differs by log 1.5, colours agree.
    larger = unlikeness(traits, traits, 1.5).diagonal()
    expected = math.log(1.5) / 0.35 / math.sqrt(2)
    torch.testing.assert_close(larger, torch.full((8,), expected, dtype=torch.float64))
    torch.testing.assert_close(unlikeness(traits, traits).diagonal(), torch.zeros(8).double())
    seen = {"made-2": torch.eye(8).double()}
    with_eyes = Traits(**{**vars(traits), "embeddings": seen})
    turned = Traits(**{**vars(traits), "embeddings": {"made-2": torch.eye(8).double().roll(1, 0)}})
    alone = unlikeness(with_eyes, turned, 1.0).diagonal()
    torch.testing.assert_close(alone, torch.full((8,), 4 / math.sqrt(3), dtype=torch.float64))
    other = Traits(**{**vars(traits), "embeddings": {"made-3": torch.eye(8).double()}})
    torch.testing.assert_close(unlikeness(with_eyes, other, 1.0), same)


def test_points_lie_on_surfaces_of_their_colour_alone():
    red, blue = (
        traits_of(box_room({"thing": Thing((0, 0, 0), (1, 1, 1), color)})) for color in (RED, BLUE)
    )
    assert float((on_surfaces(red, red, 0.05) < 1).double().mean()) == 1
    assert not (on_surfaces(red, blue, 0.05) < math.inf).any()
    assert not (on_surfaces(red, red, 0.05, of=1) < math.inf).any()  # what belongs to no object


def test_the_alignment_does_not_depend_on_how_much_is_compared_at_once(
    monkeypatch: pytest.MonkeyPatch,
):
    first, second = box_room(OFFICE), box_room(OFFICE, seed=1, motion=MOTION)
    traits = traits_of(first), traits_of(second)
    whole = align(*traits, ups(first, second))
    monkeypatch.setattr("instok3d.scene.changes.alignment.AT_ONCE", 6400)
    assert align(*traits, ups(first, second)) == whole


def test_a_scene_without_surfaces_is_refused():
    first = box_room(OFFICE)
    thin = replace(first, gaussians=replace(first.gaussians, opacities=torch.full_like(
        first.gaussians.opacities, 0.1)))  # fmt: skip
    for pair in ((first, thin), (thin, first)):
        with pytest.raises(ValueError, match="no alignment of the two scenes can be trusted"):
            align(*(traits_of(scene) for scene in pair), ups(*pair))
