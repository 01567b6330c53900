"""Pictures of 24 x 24 pixels with a Gaussian and an anchor for each pixel."""

from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

import instok3d
from instok3d.cli.info import describe
from instok3d.scene import clean_up
from instok3d.scene.clean_up import Cleaned, cleaned
from instok3d.scene.record import CleanUpRecord, SceneTokens
from instok3d.types import Cameras, Gaussians
from made_model import made_model, made_photos

SIDE = 24
GREY, RED = (0.5, 0.5, 0.5), (0.9, 0.1, 0.1)
WALL = [0.9, 0.04, 0.03, 0.03]
"""Probabilities of the groups 0, 1, 2 and the void."""
CRUMB = [0.38, 0.55, 0.02, 0.05]
CUP = [0.02, 0.95, 0.02, 0.01]


@dataclass(frozen=True)
class Patch:
    """A rectangle of the picture: rows and columns, what it belongs to, and how it looks."""

    rows: tuple[int, int]
    columns: tuple[int, int]
    probabilities: list[float]
    color: tuple[float, float, float] = GREY
    depth: float = 1.98
    """Just before the wall, so that it covers it."""


def cleaned_picture(*patches: Patch, views: int = 1) -> tuple[Cleaned, torch.Tensor]:
    """The picture of the patches, later ones in front, cleaned; and the owner of each pixel.

    All views show the same.
    """
    depth, color = torch.full((SIDE, SIDE), 2.0), torch.tensor(GREY).repeat(SIDE, SIDE, 1)
    pi = torch.tensor(WALL).repeat(SIDE, SIDE, 1)
    for each in patches:
        at = slice(*each.rows), slice(*each.columns)
        depth[at], color[at] = each.depth, torch.tensor(each.color)
        pi[at] = torch.tensor(each.probabilities)
    y, x = torch.meshgrid(*[(torch.arange(SIDE) + 0.5 - SIDE / 2) / 20] * 2, indexing="ij")
    means = (torch.stack([x, y, torch.ones_like(x)], dim=-1) * depth[..., None]).view(-1, 3)
    count = len(means)
    gaussians = Gaussians(
        means, torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        (0.005 * depth.view(-1, 1)).repeat(1, 3), torch.full((count,), 0.95),
        (color.view(count, 1, 3) - 0.5) / 0.28209479, torch.arange(count),
    )  # fmt: skip
    tokens = SceneTokens(means, torch.zeros(count, 2), torch.zeros(3, 2), pi.view(count, 4))
    intrinsics = torch.tensor([[20.0, 0, SIDE / 2], [0, 20, SIDE / 2], [0, 0, 1]])
    cameras = Cameras(torch.eye(4).repeat(views, 1, 1), intrinsics.repeat(views, 1, 1))
    done = cleaned(gaussians, tokens, cameras, SIDE, SIDE, near=0.05, far=100.0)
    owner = done.tokens.assignment.argmax(dim=1)[done.gaussians.anchor_index]
    return done, owner.view(SIDE, SIDE)


def test_a_crumb_joins_the_group_on_whose_surface_it_lies():
    done, owner = cleaned_picture(Patch((8, 13), (8, 13), CRUMB))
    assert done.record.joined == 1
    assert (owner == 0).all()
    torch.testing.assert_close(done.tokens.assignment.sum(dim=1), torch.ones(SIDE * SIDE))
    assert (done.tokens.assignment[:, 1] == 0).all()


@pytest.mark.parametrize(
    "cup",
    [
        Patch((8, 12), (8, 12), CUP),
        Patch((8, 12), (8, 12), [0.25, 0.7, 0.02, 0.03], color=RED),
        Patch((8, 12), (8, 12), CRUMB, depth=1.4),
    ],
    ids=["sure", "of another colour", "with a gap behind it"],
)
def test_a_small_thing_that_stands_out_stays(cup: Patch):
    done, owner = cleaned_picture(cup)
    assert done.record.joined == 0
    assert (owner[8:12, 8:12] == 1).all()


def test_halves_of_one_thing_that_the_groups_are_unsure_of_become_one():
    done, owner = cleaned_picture(
        Patch((6, 18), (4, 12), [0.02, 0.6, 0.36, 0.02], color=RED),
        Patch((6, 18), (12, 19), [0.02, 0.36, 0.6, 0.02], color=RED),
    )
    assert done.record.joined == 1
    assert (owner[6:18, 4:19] == 1).all()
    assert (owner[:5] == 0).all()


def test_sure_halves_stay_two():
    done, _ = cleaned_picture(
        Patch((6, 18), (4, 12), [0.02, 0.93, 0.03, 0.02], color=RED),
        Patch((6, 18), (12, 19), [0.02, 0.03, 0.93, 0.02], color=RED),
    )
    assert done.record.joined == 0


@pytest.mark.parametrize("views", [1, 8])
def test_a_group_on_which_the_wall_has_a_third_of_its_own_map_stays(views: int):
    done, owner = cleaned_picture(Patch((8, 13), (8, 13), [0.22, 0.68, 0.05, 0.05]), views=views)
    assert done.record.joined == 0
    assert (owner[8:13, 8:13] == 1).all()
    assert cleaned_picture(Patch((8, 13), (8, 13), CRUMB), views=views)[0].record.joined == 1


UNSURE = [0.12, 0.47, 0.23, 0.18]
"""A quarter of its map is the wall's: too little for a group to join another one."""


def test_a_small_group_that_is_unsure_joins_what_it_lies_on():
    done, owner = cleaned_picture(Patch((8, 10), (8, 11), UNSURE))
    assert done.record == CleanUpRecord(joined=1, moved=0)
    assert (owner == 0).all()
    assert (done.tokens.assignment[:, 1] == 0).all()


@pytest.mark.parametrize(
    "patch",
    [
        Patch((8, 10), (8, 11), [0.17, 0.6, 0.05, 0.18]),
        Patch((8, 14), (8, 14), UNSURE),
        Patch((8, 10), (8, 11), UNSURE, color=RED),
        Patch((8, 10), (8, 11), UNSURE, depth=1.4),
        Patch((8, 10), (8, 11), [0.05, 0.47, 0.3, 0.18]),
    ],
    ids=["sure", "larger", "of another colour", "with a gap behind it", "without its map"],
)
def test_other_small_groups_stay(patch: Patch):
    done, owner = cleaned_picture(patch)
    assert done.record.joined == 0
    rows, columns = slice(*patch.rows), slice(*patch.columns)
    assert (owner[rows, columns] == 1).all()


def test_a_chain_of_crumbs_ends_in_the_largest():
    done, owner = cleaned_picture(
        Patch((6, 14), (6, 14), CRUMB), Patch((9, 12), (14, 17), [0.05, 0.44, 0.46, 0.05])
    )
    assert done.record.joined == 2
    assert (owner == 0).all()


def test_each_view_is_rendered_once_however_many_groups_join(monkeypatch):
    rendered, plain = [], clean_up.render
    monkeypatch.setattr(
        clean_up, "render", lambda *args, **more: rendered.append(1) or plain(*args, **more)
    )
    crumbs = [Patch((8, 13), (8, 13), CRUMB), Patch((16, 18), (16, 19), [0.3, 0.1, 0.5, 0.1])]
    done, _ = cleaned_picture(*crumbs, views=2)
    assert done.record.joined == 2
    assert len(rendered) == 2


def test_a_loose_piece_goes_to_what_surrounds_it_and_the_main_part_stays():
    chair = Patch((3, 12), (3, 12), CUP, color=RED)
    done, owner = cleaned_picture(chair, Patch((17, 20), (17, 20), [0.45, 0.5, 0.02, 0.03]))
    assert done.record == CleanUpRecord(joined=0, moved=9)
    assert (owner[17:20, 17:20] == 0).all()
    assert (owner[3:12, 3:12] == 1).all()
    torch.testing.assert_close(done.tokens.assignment.sum(dim=1), torch.ones(SIDE * SIDE))


@pytest.mark.parametrize(
    "piece",
    [
        Patch((17, 20), (17, 20), CUP, color=RED),
        Patch((17, 20), (17, 20), [0.45, 0.5, 0.02, 0.03], depth=1.4),
    ],
    ids=["sure", "with a gap behind it"],
)
def test_a_loose_piece_that_stands_out_stays(piece: Patch):
    done, owner = cleaned_picture(Patch((3, 12), (3, 12), CUP, color=RED), piece)
    assert done.record.moved == 0
    assert (owner[17:20, 17:20] == 1).all()


def test_the_void_takes_nothing_and_joins_nothing():
    void = [0.3, 0.02, 0.08, 0.6]
    done, owner = cleaned_picture(
        Patch((0, 24), (0, 14), void), Patch((5, 8), (5, 8), [0.01, 0.5, 0.04, 0.45])
    )
    assert done.record == CleanUpRecord(0, 0)
    assert (owner[5:8, 5:8] == 1).all()
    assert (owner[10:, :14] == 3).all()


def test_a_picture_without_crumbs_is_left_as_it_is_to_the_bit():
    done, owner = cleaned_picture(Patch((4, 16), (4, 16), CUP, color=RED))
    assert done.record == CleanUpRecord(0, 0)
    assert done.gaussians.anchor_index.tolist() == list(range(SIDE * SIDE))
    assert (owner == 1).sum() == 144


def test_nothing_to_clean():
    intrinsics = torch.tensor([[20.0, 0, 4], [0, 20, 4], [0, 0, 1]])
    cameras = Cameras(torch.eye(4)[None], intrinsics[None])
    none = Gaussians(
        torch.zeros(0, 3), torch.zeros(0, 4), torch.zeros(0, 3), torch.zeros(0),
        torch.zeros(0, 1, 3), torch.zeros(0, dtype=torch.long),
    )  # fmt: skip
    tokens = SceneTokens(torch.zeros(0, 3), torch.zeros(0, 2), torch.zeros(0, 2), torch.zeros(0, 1))
    done = cleaned(none, tokens, cameras, 8, 8, near=0.05, far=100.0)
    assert done == Cleaned(none, tokens, CleanUpRecord(0, 0))


def test_reconstruct_says_what_was_cleaned_up_and_leaves_it_out_if_told(tmp_path: Path):
    photos, model = tmp_path / "photos", made_model(tmp_path / "model.safetensors")
    made_photos(photos)
    plain = instok3d.reconstruct(photos, model=model, refine=0, clean_up=False)
    whole = instok3d.reconstruct(photos, model=model, refine=0)
    assert plain.provenance.clean_up is None
    assert plain.provenance.tokens_give_gaussians
    record = whole.provenance.clean_up
    assert record is not None
    gone = (whole.tokens.assignment[:, :-1].sum(dim=0) == 0).sum()
    assert record.joined == gone
    assert whole.provenance.tokens_give_gaussians == (record.moved == 0)
    for item in whole.objects:
        rows = whole.gaussians.rows(slice(item.gaussian_range[0], sum(item.gaussian_range)))
        owners = whole.tokens.assignment[rows.anchor_index].argmax(dim=1)
        assert (owners == item.id - 1).all()
    whole.save(tmp_path / "whole.itk")
    assert instok3d.load(tmp_path / "whole.itk").provenance == whole.provenance
    assert "cleaned up: " in describe(whole)
    assert "cleaned up: " not in describe(plain)
