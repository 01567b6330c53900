import os
import re
import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from fake_rooms import FakeRooms
from instok3d.data.batches import SceneBatches
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.held_out import split_scenes, validation_samples
from instok3d.training.loop import train
from instok3d.training.run_log import read_metrics
from instok3d.training.update import NonFiniteLossError, parameter_groups
from kill_points import die_in
from terminal import on_terminal
from toy_stage import TINY, ToyStage

ROOMS = FakeRooms(5, size=16)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    checkpoint = read_checkpoint(folder)
    return {**checkpoint["model"], **{f"average.{k}": v for k, v in checkpoint["average"].items()}}


def assert_same_run(a: Path, b: Path) -> None:
    first, second = weights(a), weights(b)
    assert first.keys() == second.keys()
    for name in first:
        assert torch.equal(first[name], second[name]), name


def test_resumed_run_equals_uninterrupted_run_bit_for_bit(tmp_path):
    """With dropout, averaged weights and validation in between, and rooms that grew meanwhile."""
    assert train(TINY, ToyStage(), ROOMS, tmp_path / "straight").reason == "finished"

    part = replace(TINY, validate_every_steps=2)
    outcome = train(part, ToyStage(), ROOMS, tmp_path / "parts", time_limit_min=0.0)
    assert (outcome.step, outcome.reason) == (0, "time limit")
    stopping = replace(part, steps=3, cosine_steps=TINY.steps)
    train(stopping, ToyStage(), ROOMS, tmp_path / "parts", resume=True)
    torch.manual_seed(99)
    train(part, ToyStage(), FakeRooms(9, size=16), tmp_path / "parts", resume=True)

    assert_same_run(tmp_path / "straight", tmp_path / "parts")
    assert read_checkpoint(tmp_path / "parts")["step"] == 6


def test_new_scenes_join_on_request_behind_the_held_out_ones(tmp_path):
    train(replace(TINY, steps=1), ToyStage(), FakeRooms(4, 16, first_seed=10), tmp_path)
    more = FakeRooms(20, 16)
    train(replace(TINY, steps=2), ToyStage(), more, tmp_path, resume=True)
    assert read_checkpoint(tmp_path)["scene_names"] == ["10", "11", "12", "13"]
    train(replace(TINY, steps=3), ToyStage(), more, tmp_path, resume=True, add_scenes=True)
    assert read_checkpoint(tmp_path)["scene_names"][:5] == ["10", "11", "12", "13", "0"]
    assert len(read_checkpoint(tmp_path)["scene_names"]) == 20


def test_run_leaves_metrics_pictures_and_curves(tmp_path):
    train(replace(TINY, validate_every_steps=3), ToyStage(), ROOMS, tmp_path)
    lines = read_metrics(tmp_path / "metrics.jsonl")
    assert [x["step"] for x in lines if x["kind"] == "train"] == [2, 4, 6]
    assert [x["step"] for x in lines if x["kind"] == "validation"] == [0, 3, 6]
    assert all(x["loss"] > 0 and x["step_s"] > 0 for x in lines if x["kind"] == "train")
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 3
    assert (tmp_path / "curves.png").stat().st_size > 1000


def test_a_terminal_shows_what_the_run_is_doing_and_the_time_left(tmp_path, monkeypatch):
    terminal = on_terminal(monkeypatch)
    train(TINY, ToyStage(), ROOMS, tmp_path)
    drawn = terminal.drawn
    assert "validating on 2 scenes" in drawn
    assert "step 1/6" in drawn
    assert any(re.fullmatch(r"step 4/6  [\d.]+ s/step  \dm\d\ds left", text) for text in drawn)
    assert "saving" in drawn
    assert "finished at step 6" in drawn
    assert terminal.getvalue().endswith("\r\033[K")


def test_non_finite_loss_stops_before_the_update_and_keeps_the_batch(tmp_path):
    config = replace(TINY, checkpoint_every_steps=1)
    with pytest.raises(NonFiniteLossError, match=r"step 3 .*bad_batch_00000003\.pt"):
        train(config, ToyStage(bad_step=3), ROOMS, tmp_path)
    assert read_checkpoint(tmp_path)["step"] == 3
    saved = torch.load(tmp_path / "bad_batch_00000003.pt", weights_only=True)
    batch = SceneBatches(ROOMS, range(2, 5), TINY.batches, seed=0).batch(3)
    assert saved["names"] == list(batch.names)
    assert torch.equal(saved["context"]["images"], batch.context.images)


def test_non_finite_gradient_skips_the_update_and_counts(tmp_path):
    class FromStepTwo(ToyStage):
        def loss(self, model, sample, step):
            self.bad_gradient_step = step if step >= 2 else None
            return super().loss(model, sample, step)

    train(TINY, FromStepTwo(), ROOMS, tmp_path / "six", time_limit_min=None)
    train(replace(TINY, steps=2, cosine_steps=6), ToyStage(), ROOMS, tmp_path / "two")
    assert_same_run(tmp_path / "six", tmp_path / "two")
    assert read_checkpoint(tmp_path / "six")["skipped"] == 4
    with pytest.raises(NonFiniteLossError, match="gradient"):
        train(replace(TINY, max_skipped_in_a_row=3), FromStepTwo(), ROOMS, tmp_path / "stop")


def test_signal_saves_and_ends_after_the_update(tmp_path):
    class Interrupted(ToyStage):
        def loss(self, model, sample, step):
            if step == 2:
                os.kill(os.getpid(), signal.SIGTERM)
            return super().loss(model, sample, step)

    before = signal.getsignal(signal.SIGTERM)
    outcome = train(TINY, Interrupted(), ROOMS, tmp_path)
    assert (outcome.step, outcome.reason) == (3, "interrupted")
    assert read_checkpoint(tmp_path)["step"] == 3
    assert signal.getsignal(signal.SIGTERM) is before


def test_new_run_in_the_folder_of_another_is_refused(tmp_path):
    train(replace(TINY, steps=1), ToyStage(), ROOMS, tmp_path)
    with pytest.raises(ValueError, match="pass --resume"):
        train(TINY, ToyStage(), ROOMS, tmp_path)
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        train(TINY, ToyStage(), ROOMS, tmp_path / "other", resume=True)


def test_two_processes_do_not_train_in_one_folder(tmp_path):
    class WithAnother(ToyStage):
        def loss(self, model, sample, step):
            with pytest.raises(ValueError, match="another process is at work in the run"):
                train(TINY, ToyStage(), ROOMS, tmp_path, resume=True)
            return super().loss(model, sample, step)

    train(replace(TINY, steps=1), WithAnother(), ROOMS, tmp_path)
    assert not list(tmp_path.glob(".*"))


def test_run_killed_in_its_first_checkpoint_begins_anew(tmp_path):
    checkpoints = tmp_path / "checkpoints"
    checkpoints.mkdir()
    die_in(checkpoints / "step_00000000.pt")
    assert train(replace(TINY, steps=1), ToyStage(), ROOMS, tmp_path).reason == "finished"
    assert [path.name for path in checkpoints.iterdir()] == ["step_00000001.pt"]


def test_run_starts_from_the_averaged_weights_of_another(tmp_path):
    train(TINY, ToyStage(), ROOMS, tmp_path / "first")
    once = replace(TINY, steps=0)
    train(once, ToyStage(), ROOMS, tmp_path / "next", init_from=tmp_path / "first")
    first, following = weights(tmp_path / "first"), weights(tmp_path / "next")
    for name in read_checkpoint(tmp_path / "first")["average"]:
        assert torch.equal(following[name], first[f"average.{name}"])


def test_first_weights_of_other_sizes_or_of_a_cut_file_are_named(tmp_path):
    path = tmp_path / "other.safetensors"
    save_file({"x": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match=r"other\.safetensors does not fit the sizes"):
        train(TINY, ToyStage(), ROOMS, tmp_path / "run", init_from=path)
    path.write_bytes(b"12")
    with pytest.raises(ValueError, match=r"other\.safetensors is not a whole safetensors file"):
        train(TINY, ToyStage(), ROOMS, tmp_path / "run", init_from=path)


def test_norms_biases_and_embeddings_are_not_decayed():
    model = torch.nn.ModuleDict(
        {
            "linear": torch.nn.Linear(2, 3),
            "convolution": torch.nn.Conv2d(2, 3, 1),
            "norm": torch.nn.LayerNorm(3),
            "embedding": torch.nn.Embedding(4, 2),
        }
    )
    model.register_parameter("queries", torch.nn.Parameter(torch.zeros(5, 2)))
    model["convolution"].bias.requires_grad_(False)
    decayed, plain = parameter_groups(model, 0.05)
    assert {id(p) for p in decayed["params"]} == {
        id(model["linear"].weight),
        id(model["convolution"].weight),
    }
    assert decayed["weight_decay"] == 0.05
    assert plain["weight_decay"] == 0
    assert len(plain["params"]) == 5  # linear bias, two of the norm, embedding, queries


def test_held_out_scenes_are_the_first_and_stay_so():
    held_out, training = split_scenes(ROOMS, list("0123"), 1)
    assert (held_out, training) == ([0], [1, 2, 3])
    with pytest.raises(ValueError, match=r"holdout must be at least 1 .* got 0"):
        split_scenes(ROOMS, ["0", "1"], 0)
    with pytest.raises(ValueError, match="5 scenes and 5 are held out"):
        split_scenes(ROOMS, list("01234"), 5)
    with pytest.raises(ValueError, match="no longer has, the first is 77"):
        split_scenes(ROOMS, ["0", "77"], 1)


def test_validation_looks_at_the_protocols():
    two = validation_samples(ROOMS, [0, 1, 2], 2)
    assert [s.context.images.shape[0] for s in two] == [3]
    assert two[0].names[0] == "0 frames 7,9"
    eight = validation_samples(ROOMS, [0, 1], 8)
    assert [s.target.images.shape[:2] for s in eight] == [(1, 7), (1, 7)]
    with pytest.raises(ValueError, match="2 or 8"):
        validation_samples(ROOMS, [0], 3)
