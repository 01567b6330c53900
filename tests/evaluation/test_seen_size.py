from dataclasses import replace

import pytest
import torch

from flat_rooms import oracle
from instok3d.data.sample import Sample
from instok3d.evaluation.methods import show
from instok3d.evaluation.prediction import predict_by
from instok3d.evaluation.seen_size import geometry_at, views_at
from instok3d.evaluation.tokenizer_method import TokenizerMethod
from instok3d.types import TokenGroups, Views


def test_views_of_half_the_size_by_hand():
    depths = torch.arange(16.0).view(1, 1, 4, 4)
    intrinsics = torch.tensor([[[[8.0, 0, 2], [0, 6, 1], [0, 0, 1]]]])
    views = Views(torch.full((1, 1, 3, 4, 4), 0.25), intrinsics, torch.eye(4)[None, None], depths)
    half = views_at(views, 2, 2)
    torch.testing.assert_close(half.images, torch.full((1, 1, 3, 2, 2), 0.25))
    wanted = torch.tensor([[4.0, 0, 1], [0, 3, 0.5], [0, 0, 1]])
    assert torch.equal(half.intrinsics[0, 0], wanted)
    assert torch.equal(half.depths[0, 0], torch.tensor([[5.0, 7], [13, 15]]))
    assert torch.equal(half.cam_from_world, views.cam_from_world)


def test_bare_photos_stay_bare_and_stripes_are_averaged():
    stripes = torch.tensor([0.0, 1.0]).repeat(8).expand(1, 2, 3, 16, 16)
    half = views_at(Views(stripes), 8, 8)
    assert half.intrinsics is half.depths is half.cam_from_world is None
    torch.testing.assert_close(
        half.images[..., 1:-1], torch.full((1, 2, 3, 8, 6), 0.5), atol=0.01, rtol=0
    )


def test_the_same_size_changes_nothing(flat_sample: Sample):
    context = flat_sample.context
    assert views_at(context, *context.images.shape[-2:]) is context
    geometry = oracle(flat_sample)(context).geometry
    assert geometry_at(geometry, *geometry.depths.shape[-2:]) is geometry


def smaller_oracle(sample: Sample, seen: list[Views]):
    """Tells the truth of a sample by views of another size, with the Gaussians of all pixels."""

    def model(views: Views) -> TokenGroups:
        seen.append(views)
        groups = oracle(sample)(views)
        geometry = geometry_at(groups.geometry, *views.images.shape[-2:])
        return replace(groups, geometry=geometry)

    return model


@pytest.mark.parametrize("mode", ["predicted", "given"])
def test_the_size_that_the_model_sees_moves_no_camera(flat_sample: Sample, mode):
    seen: list[Views] = []
    where = "true" if mode == "given" else "aligned"
    plain = predict_by(
        TokenizerMethod(oracle(flat_sample), mode), flat_sample, target_cameras=where
    )
    method = TokenizerMethod(smaller_oracle(flat_sample, seen), mode, pixels=16)
    small = predict_by(method, flat_sample, target_cameras=where)
    assert seen[0].images.shape[-2:] == (16, 16)
    torch.testing.assert_close(small.images, plain.images, atol=1e-4, rtol=0)
    torch.testing.assert_close(small.cameras.intrinsics, plain.cameras.intrinsics)
    assert small.geometry is not None
    assert small.geometry.depths.shape == flat_sample.context.depths.shape
    if mode == "given":
        halved = flat_sample.context.intrinsics[..., :2, :] / 2
        torch.testing.assert_close(seen[0].intrinsics[..., :2, :], halved)


def test_refinement_looks_at_the_photos_that_the_model_saw(flat_sample: Sample):
    seen: list[Views] = []
    method = TokenizerMethod(smaller_oracle(flat_sample, seen), refine=3, pixels=16)
    scene = method.fit(show(flat_sample, method.needs))
    torch.testing.assert_close(
        scene.cameras.intrinsics, oracle(flat_sample)(seen[0]).geometry.cameras.intrinsics[0]
    )
    before = oracle(flat_sample)(seen[0]).gaussians.scene(0)
    assert not torch.equal(scene.gaussians.opacities, before.opacities)
