from dataclasses import replace
from typing import get_args

import pytest
import torch

from easy_room import QUICK, SIZE, own_quality
from instok3d.baselines.feature_files import MODELS, FeatureMethodName
from instok3d.baselines.registry import METHODS, MethodName
from instok3d.cli import evaluate as command
from instok3d.evaluation.methods import Method, Shown, show
from instok3d.training.config import PRESETS


def test_every_name_has_a_method_and_the_command_knows_it():
    assert set(METHODS) == set(get_args(MethodName))
    assert set(get_args(command.Method)) == {"tokenizer", *METHODS, *MODELS}
    assert set(MODELS) == set(get_args(FeatureMethodName))
    assert {f"nano-{name}" for name in MODELS} <= set(PRESETS)


@pytest.mark.parametrize("name", METHODS)
def test_a_method_knows_what_it_was_shown(name, easy_sample, easy_shown):
    """Working at all: photos above 26 dB, own masks above .9 mean IoU."""
    method = METHODS[name](QUICK)
    assert isinstance(method, Method)
    shown = show(easy_sample, method.needs, easy_shown.masks)
    scene = method.fit(shown)
    psnr, iou = own_quality(scene, shown)
    assert psnr > 26
    assert scene.cost.gaussians == len(scene.gaussians.means)
    assert scene.gaussians.opacities.isfinite().all()
    if "masks" not in method.needs:
        assert scene.assignment is None
        assert scene.num_groups_used() is None
        assert scene.cost.semantic_units == scene.cost.label_scalars == 0
        return
    assert iou > 0.9
    assert scene.assignment is not None
    torch.testing.assert_close(scene.assignment.sum(dim=1), torch.ones(len(scene.assignment)))
    assert len(scene.assignment) > int(scene.gaussians.anchor_index.max())
    assert scene.num_groups_used() == 4


@pytest.mark.parametrize("name", METHODS)
def test_equal_seeds_give_equal_bits(name, easy_shown):
    settings = replace(QUICK, steps=12, points=300, density=replace(QUICK.density, every=3))
    first, second = (METHODS[name](settings).fit(easy_shown) for _ in range(2))
    assert torch.equal(first.gaussians.means, second.gaussians.means)
    other = METHODS[name](replace(settings, seed=1)).fit(easy_shown)
    assert not torch.equal(first.gaussians.means[:9], other.gaussians.means[:9])


@pytest.mark.parametrize("name", [name for name in METHODS if name != "3dgs"])
def test_without_any_mask_there_is_no_instance(name, easy_shown):
    empty = replace(easy_shown, masks=torch.zeros_like(easy_shown.masks))
    settings = replace(QUICK, steps=2, points=50)
    scene = METHODS[name](settings).fit(empty)
    assert scene.num_groups_used() == 0
    seen = scene.at(empty.cameras, SIZE, SIZE)
    assert seen.masks is not None
    assert all((each.ids == -1).all() and not len(each.scores) for each in seen.masks)


@pytest.mark.parametrize("name", METHODS)
def test_what_is_needed_and_not_shown_is_named(name, easy_shown):
    views = replace(easy_shown.views, depths=None)
    with pytest.raises(ValueError, match="depth of the context views is not shown"):
        METHODS[name](QUICK).fit(Shown(views, easy_shown.masks))
    nowhere = replace(easy_shown.views, depths=torch.zeros_like(easy_shown.views.depths))
    with pytest.raises(ValueError, match="no pixel of the context views has a known depth"):
        METHODS[name](QUICK).fit(Shown(nowhere, easy_shown.masks))
    if name != "3dgs":
        with pytest.raises(ValueError, match="masks of the context views are not shown"):
            METHODS[name](QUICK).fit(Shown(easy_shown.views))
