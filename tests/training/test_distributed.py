"""Two processes on gloo against one: the same weights, and never one that waits for the other."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch

import processes
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.config import TrainConfig
from instok3d.training.distributed import Processes, joined_processes, share
from instok3d.training.run_log import read_metrics
from instok3d.training.stages.tokenizer import TokenizerStageConfig
from processes import run_processes
from toy_stage import TINY, ToyStage, ToyStageConfig

TOY = replace(TINY, stage=ToyStageConfig(dropout=0.0), steps=5, clip_norm=0.05, threads=1)
"""The norm of every gradient is above what it is clipped to."""
TOKENIZER = replace(
    TOY,
    stage=TokenizerStageConfig(
        backbone=NanoConfig(width=64, layers=1),
        tokenizer=TokenizerConfig(
            width=64,
            num_anchors=8,
            num_groups=4,
            anchor_layers=1,
            group_layers=1,
            gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
        ),
        seg_weight=1.0,
        seg_warmup_steps=0,
    ),
    lr=1e-3,
    holdout=1,
)


def with_batch(config: TrainConfig, size: int) -> TrainConfig:
    return replace(config, batches=replace(config.batches, batch_size=size))


def run(config: TrainConfig, folder: Path) -> None:
    processes.train_run(config, folder)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Callable[[TrainConfig], Path]:
    """The folder of a run of one process with batches of four, trained once."""

    @cache
    def trained(config: TrainConfig) -> Path:
        folder = tmp_path_factory.mktemp("alone") / "run"
        run(with_batch(config, 4), folder)
        return folder

    return trained


def run_two(config: TrainConfig, folder: Path) -> None:
    run_processes(2, processes.train_run, config, folder)


def assert_nearly_the_same_run(a: Path, b: Path, steps: int) -> None:
    """99 of 100 weights to 1e-6, all to 1e-4; five updates move one by up to 5e-3 and more.

    The mean of two halves is rounded otherwise than the mean of the whole. Adam divides each entry
    of the gradient by its size, so one that would be zero but for the rounding (a bias of all keys
    of an attention) goes its own way.
    """
    first, second = read_checkpoint(a), read_checkpoint(b)
    assert first["step"] == second["step"] == steps
    for part in ("model", "average"):
        assert first[part].keys() == second[part].keys()
        pairs = [(value, second[part][name]) for name, value in first[part].items()]
        difference = torch.cat([(x - y).abs().flatten().float() for x, y in pairs])
        assert difference.max() <= 1e-4
        assert (difference > 1e-6).float().mean() < 0.01


@pytest.mark.parametrize("strategy", ["ddp", "fsdp"])
@pytest.mark.parametrize(
    "config", [TOY, pytest.param(TOKENIZER, marks=pytest.mark.slow)], ids=["toy", "tokenizer"]
)
def test_two_processes_with_half_the_batch_each_make_the_same_weights(
    config, strategy, alone, tmp_path
):
    run_two(replace(with_batch(config, 2), strategy=strategy), tmp_path / "two")
    assert_nearly_the_same_run(alone(config), tmp_path / "two", config.steps)


@pytest.mark.parametrize("config", [TOY, TOKENIZER], ids=["toy", "tokenizer"])
def test_half_the_batch_twice_makes_the_same_weights(config, alone, tmp_path):
    run(replace(with_batch(config, 2), accumulate=2), tmp_path / "halves")
    assert_nearly_the_same_run(alone(config), tmp_path / "halves", config.steps)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["ddp", "fsdp"])
def test_processes_that_accumulate_make_the_same_weights(strategy, alone, tmp_path):
    run_two(replace(with_batch(TOY, 1), accumulate=2, strategy=strategy), tmp_path / "two")
    assert_nearly_the_same_run(alone(TOY), tmp_path / "two", TOY.steps)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["ddp", "fsdp"])
def test_resumed_run_of_two_processes_is_the_same_bit_for_bit(strategy, tmp_path):
    """With dropout, which each process draws for itself."""
    config = replace(TOY, strategy=strategy, cosine_steps=5)
    run_processes(2, processes.train_toy, config, tmp_path / "straight", 0.5)
    run_processes(2, processes.train_toy, replace(config, steps=2), tmp_path / "parts", 0.5)
    run_processes(2, processes.train_toy, config, tmp_path / "parts", 0.5, True)
    first, second = read_checkpoint(tmp_path / "straight"), read_checkpoint(tmp_path / "parts")
    for part in ("model", "average"):
        for name, value in first[part].items():
            assert torch.equal(value, second[part][name]), name
    assert len(first["random"]) == 2
    assert not torch.equal(first["random"][0]["torch"], first["random"][1]["torch"])


def test_shards_saved_by_two_processes_go_on_in_one(tmp_path):
    """Which holds the whole model and sees the whole batch."""
    config = replace(TOY, strategy="fsdp", cosine_steps=5)
    run(with_batch(config, 4), tmp_path / "one")
    run_two(with_batch(replace(config, steps=2), 2), tmp_path / "two")
    with pytest.warns(UserWarning, match="had 2 processes and now has 1"):
        processes.train_toy(with_batch(config, 4), tmp_path / "two", 0.0, True)
    assert_nearly_the_same_run(tmp_path / "one", tmp_path / "two", config.steps)
    shapes = {name: value.shape for name, value in ToyStage().build_model().state_dict().items()}
    saved = read_checkpoint(tmp_path / "two")["model"]
    assert {name: value.shape for name, value in saved.items()} == shapes


def test_one_bad_process_stops_both_before_the_update(tmp_path):
    config = replace(TOY, checkpoint_every_steps=1)
    said = run_processes(2, processes.train_toy_with_one_bad_process, config, tmp_path)
    assert said[0] == said[1]
    assert "step 2" in said[0]
    assert "bad_batch_00000002_process1.pt" in said[0]
    assert [path.name for path in tmp_path.glob("bad_batch*")] == ["bad_batch_00000002_process1.pt"]
    assert read_checkpoint(tmp_path)["step"] == 2


def test_signal_to_one_process_ends_both_with_a_checkpoint(tmp_path):
    ends = run_processes(2, processes.train_toy_with_one_stopped_process, TOY, tmp_path)
    assert ends == [(3, "interrupted")] * 2
    assert read_checkpoint(tmp_path)["step"] == 3
    # Only the first process writes.
    lines = read_metrics(tmp_path / "metrics.jsonl")
    assert [(line["kind"], line["step"]) for line in lines] == [("validation", 0), ("train", 2)]


def test_one_gpu_is_not_given_to_several_processes(monkeypatch):
    for name, value in {"WORLD_SIZE": "2", "RANK": "0", "LOCAL_RANK": "0"}.items():
        monkeypatch.setenv(name, value)
    with (
        pytest.raises(ValueError, match="cuda:1 is one GPU, and there are 2 processes"),
        joined_processes("cuda:1"),
    ):
        pass


def test_a_single_process_is_not_shared():
    stage = ToyStage()
    for strategy in ("auto", "single", "ddp", "fsdp"):
        loss = share(stage, stage.build_model(), Processes(), strategy)
        assert type(loss).__name__ == "SharedLoss"
    with pytest.raises(ValueError, match="'single' is for one process, got 2"):
        share(stage, stage.build_model(), Processes(1, 2, 1), "single")
