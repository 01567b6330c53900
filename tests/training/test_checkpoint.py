import random

import numpy as np
import pytest
import torch
from torch import nn

from instok3d.training.checkpoint import (
    RunState,
    WeightAverage,
    read_checkpoint,
    read_weights,
    restore,
    save_checkpoint,
)


def make_state() -> RunState:
    model = nn.Linear(40, 30)
    optimizer = torch.optim.AdamW(model.parameters(), fused=True)
    return RunState(model, optimizer, WeightAverage(model, 0.9), scene_names=["3", "1"])


def test_last_two_checkpoints_stay(tmp_path):
    state = make_state()
    for step in (1, 2, 30):
        state.step = step
        save_checkpoint(tmp_path, state, {})
    names = sorted(path.name for path in (tmp_path / "checkpoints").iterdir())
    assert names == ["step_00000002.pt", "step_00000030.pt"]
    assert read_checkpoint(tmp_path)["step"] == 30


@pytest.mark.parametrize("damage", ["cut", "empty", "changed"])
def test_torn_newest_checkpoint_falls_back_with_a_warning(tmp_path, damage):
    state = make_state()
    save_checkpoint(tmp_path, state, {})
    state.step = 1
    newest = save_checkpoint(tmp_path, state, {})
    content = bytearray(newest.read_bytes())
    if damage == "changed":
        place = content.find(state.model.weight.detach().numpy().tobytes()[:64])
        assert place > 0
        content[place] ^= 0xFF
    newest.write_bytes({"cut": content[: len(content) // 2], "empty": b""}.get(damage, content))
    with pytest.warns(UserWarning, match="step_00000001.pt is damaged"):
        assert read_checkpoint(tmp_path)["step"] == 0


def test_nothing_whole_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        read_checkpoint(tmp_path)
    save_checkpoint(tmp_path, make_state(), {}).write_bytes(b"x")
    with pytest.warns(UserWarning, match="damaged"), pytest.raises(ValueError, match="all checkp"):
        read_checkpoint(tmp_path)


def test_restore_brings_back_all_generators(tmp_path):
    torch.manual_seed(5)
    np.random.seed(5)
    random.seed(5)
    save_checkpoint(tmp_path, make_state(), {})
    expected = torch.rand(3), np.random.rand(3), random.random()
    torch.rand(7), np.random.rand(7), random.random()
    state = make_state()
    restore(state, read_checkpoint(tmp_path))
    assert torch.equal(torch.rand(3), expected[0])
    assert np.array_equal(np.random.rand(3), expected[1])
    assert random.random() == expected[2]
    assert state.scene_names == ["3", "1"]


def test_seeds_of_an_older_checkpoint_become_names(tmp_path):
    path = save_checkpoint(tmp_path, make_state(), {})
    content = torch.load(path, weights_only=True)
    del content["scene_names"]
    torch.save({**content, "version": 1, "scene_seeds": [3, 1]}, path)
    assert read_checkpoint(tmp_path)["scene_names"] == ["3", "1"]


def test_average_by_hand():
    # Step 0: keep 1/10, so 0.1 * 0 + 0.9 * 1 = 0.9. Step 90: keep min(.5, 91/100) = .5: 0.95.
    model = nn.Linear(1, 1, bias=False)
    nn.init.zeros_(model.weight)
    average = WeightAverage(model, 0.5)
    nn.init.ones_(model.weight)
    average.update(model, 0)
    torch.testing.assert_close(average.values["weight"], torch.tensor([[0.9]]))
    average.update(model, 90)
    torch.testing.assert_close(average.values["weight"], torch.tensor([[0.95]]))
    with average.applied(model):
        torch.testing.assert_close(model.weight.data, torch.tensor([[0.95]]))
    torch.testing.assert_close(model.weight.data, torch.tensor([[1.0]]))


def test_frozen_parameters_have_no_average():
    model = nn.Linear(2, 2)
    model.weight.requires_grad_(False)
    assert list(WeightAverage(model, 0.9).values) == ["bias"]


def test_without_decay_no_average_is_kept_and_a_resumed_run_may_begin_one(tmp_path):
    state = make_state()
    state.average = WeightAverage(state.model, 0.0)
    own = state.model.weight.detach().clone()
    state.average.update(state.model, 3)
    with state.average.applied(state.model):
        assert torch.equal(state.model.weight, own)
    save_checkpoint(tmp_path, state, {})
    assert read_checkpoint(tmp_path)["average"] == {}
    assert torch.equal(read_weights(tmp_path)["weight"], own)
    again = make_state()
    restore(again, read_checkpoint(tmp_path))
    assert torch.equal(again.average.values["weight"], own)


def test_first_weights_come_from_nowhere_else(tmp_path):
    with pytest.raises(FileNotFoundError, match="no run folder"):
        read_weights(tmp_path / "missing.safetensors")
