"""Operations on all the tensors of a stage."""

import pytest
import torch

from instok3d.types import Anchors, Cameras, Gaussians, Geometry, Views, check_gaussians


def gaussians(count: int, *, batch: tuple[int, ...] = (), first: float = 0.0) -> Gaussians:
    values = first + torch.arange(count, dtype=torch.float32)
    column = values.expand(*batch, count)
    return Gaussians(
        means=column[..., None].expand(*batch, count, 3),
        quats=torch.tensor([1.0, 0, 0, 0]).expand(*batch, count, 4),
        scales=torch.ones(*batch, count, 3),
        opacities=column / 10,
        sh=torch.zeros(*batch, count, 4, 3),
        anchor_index=column.long(),
    )


def cameras(count: int) -> Cameras:
    cam_from_world = torch.eye(4).repeat(count, 1, 1)
    cam_from_world[:, 2, 3] = torch.arange(count)
    return Cameras(cam_from_world, torch.eye(3).repeat(count, 1, 1))


def test_a_stage_shows_sizes_instead_of_numbers():
    expected = "Cameras(cam_from_world=float32[1, 4, 4], intrinsics=float32[1, 3, 3])"
    assert repr(cameras(1)) == expected
    views = Views(torch.zeros(1, 2, 3, 4, 4))
    assert repr(views) == (
        "Views(images=float32[1, 2, 3, 4, 4], intrinsics=None, cam_from_world=None, depths=None)"
    )


@pytest.mark.parametrize(
    "which",
    [slice(1, 3), torch.tensor([False, True, True, False]), torch.tensor([1, 2])],
)
def test_rows_are_those_asked_for_in_every_field(which: slice | torch.Tensor):
    chosen = gaussians(4).rows(which)
    assert chosen.means[:, 0].tolist() == [1, 2]
    assert chosen.anchor_index.tolist() == [1, 2]
    assert {len(value) for value in vars(chosen).values()} == {2}


def test_no_row_is_a_scene_without_gaussians():
    nothing = gaussians(4).rows(slice(0, 0))
    assert nothing.sh.shape == (0, 4, 3)
    both = Gaussians.concatenate([nothing, gaussians(2)])
    assert torch.equal(both.means, gaussians(2).means)


def test_parts_are_joined_in_order():
    both = Gaussians.concatenate([gaussians(2), gaussians(1, first=7)])
    assert both.opacities.tolist() == pytest.approx([0, 0.1, 0.7])
    assert both.anchor_index.tolist() == [0, 1, 7]
    with pytest.raises(ValueError, match="at least one part"):
        Gaussians.concatenate([])


def test_anchors_are_joined_along_their_own_axis():
    part = Anchors(torch.zeros(1, 2, 3), torch.zeros(1, 2, 5), torch.tensor([[3, 4]]))
    assert Anchors.concatenate([part, part], axis=1).patches.tolist() == [[3, 4, 3, 4]]


def test_a_scene_of_a_batch_and_a_batch_of_one_undo_each_other():
    one = gaussians(3)
    again = one.batched().scene(0)
    assert all(torch.equal(vars(again)[name], value) for name, value in vars(one).items())
    assert gaussians(3, batch=(2,)).scene(1).means.shape == (3, 3)


def test_a_view_keeps_the_view_axis():
    assert cameras(3).view(2).cam_from_world[:, 2, 3].tolist() == [2]
    assert cameras(3).batched().view(1).cam_from_world[0, :, 2, 3].tolist() == [1]
    assert cameras(3).views([2, 0]).cam_from_world[:, 2, 3].tolist() == [2, 0]
    assert cameras(3).views([]).intrinsics.shape == (0, 3, 3)


@pytest.mark.parametrize("index", [-1, 3])
def test_a_view_that_is_not_there_is_named(index: int):
    with pytest.raises(IndexError, match=f"no view {index}; there are 3"):
        cameras(3).view(index)


def test_what_is_unknown_stays_unknown_and_nested_stages_are_reached():
    bare = Views(images=torch.zeros(1, 2, 3, 4, 4))
    assert bare.to("meta").depths is None
    assert bare.to("meta").images.is_meta
    geometry = Geometry(
        features=torch.zeros(1, 1, 4, 8),
        depths=torch.ones(1, 1, 4, 4),
        pointmaps=torch.zeros(1, 1, 4, 4, 3),
        confidences=torch.ones(1, 1, 4, 4),
        cameras=cameras(1).batched(),
    )
    both = Geometry.concatenate([geometry, geometry])
    assert both.depths.shape == (2, 1, 4, 4)
    assert both.cameras.intrinsics.shape == (2, 1, 3, 3)
    assert geometry.map(lambda value: value + 1).cameras.intrinsics[0, 0, 0].tolist() == [2, 1, 1]


@pytest.mark.parametrize("batch", [(), (2,)])
def test_gaussians_that_can_be_drawn_pass_and_none_do_too(batch):
    check_gaussians(gaussians(10, batch=batch), "x")
    check_gaussians(gaussians(0, batch=batch), "x")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("means", torch.nan), ("means", -1e10), ("quats", 0.0), ("quats", torch.nan),
        ("scales", 0.0), ("scales", 1e10), ("scales", torch.nan), ("opacities", -0.01),
        ("opacities", 1.01), ("opacities", torch.nan), ("sh", torch.inf), ("anchor_index", -1),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_drawn_is_named(name: str, value: float):
    tensors = {key: tensor.clone() for key, tensor in vars(gaussians(5)).items()}
    tensors[name][2] = value
    with pytest.raises(ValueError, match=rf"a\.itk has \d+ values in {name} that are no "):
        check_gaussians(Gaussians(**tensors), "a.itk")


def test_two_colour_coefficients_are_of_no_degree():
    five = gaussians(5)
    with pytest.raises(ValueError, match="x has 2 colour coefficients in sh, wanted 1, 4, 9 or 16"):
        check_gaussians(Gaussians(**(vars(five) | {"sh": five.sh[:, :2]})), "x")
