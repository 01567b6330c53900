"""A run that is killed again and again ends as the one that was left alone."""

import json
import random
import time
from dataclasses import replace

import pytest
import torch

import processes
from instok3d.training.checkpoint import KEPT, read_checkpoint
from instok3d.training.run_log import read_metrics
from processes import SERVER
from toy_stage import TINY

KILLS = 20
CONFIG = replace(
    TINY,
    steps=100,
    threads=1,
    checkpoint_every_steps=1,
    validate_every_steps=20,
    log_every_steps=7,
)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*is damaged")
def test_run_killed_at_twenty_random_points_ends_bit_for_bit_the_same(tmp_path):
    """Half of the kills strike a file operation, in the middle of a checkpoint too."""
    processes.train_toy(CONFIG, tmp_path / "straight", 0.5)
    rng = random.Random(0)
    kills = 0
    ends: list[int] = []
    while not (ends and ends[-1] == CONFIG.steps):
        strike = None
        if kills < KILLS and kills % 2 == 0:
            strike = rng.choice(["write", "open", "rename"]), rng.randint(1, 6)
        process = SERVER.Process(
            target=processes.train_toy_until_killed, args=(CONFIG, tmp_path / "killed", strike)
        )
        process.start()
        if kills < KILLS and strike is None:
            wait_for_a_checkpoint_of_its_own(process, tmp_path / "killed", ends)
            time.sleep(rng.uniform(0, 0.03))
            process.kill()
        process.join(processes.SECONDS)
        assert process.exitcode in (0, -9)
        kills += process.exitcode == -9
        ends.append(newest_step(tmp_path / "killed"))
    assert kills == KILLS, ends

    first, second = read_checkpoint(tmp_path / "straight"), read_checkpoint(tmp_path / "killed")
    for part in ("model", "average"):
        for name, value in first[part].items():
            assert torch.equal(value, second[part][name]), name
    assert len(list((tmp_path / "killed" / "checkpoints").iterdir())) == KEPT

    # The record has every line once; only means that a kill cut short may differ.
    lines = read_metrics(tmp_path / "killed" / "metrics.jsonl")
    keys = [(line["kind"], line["step"]) for line in lines]
    assert len(set(keys)) == len(keys)
    expected = read_metrics(tmp_path / "straight" / "metrics.jsonl")
    assert sorted(keys) == sorted((line["kind"], line["step"]) for line in expected)
    json.loads((tmp_path / "killed" / "config.json").read_text())


def newest_step(folder) -> int:
    names = [path.stem for path in (folder / "checkpoints").glob("step_*.pt")]
    return max((int(name.removeprefix("step_")) for name in names), default=-1)


def wait_for_a_checkpoint_of_its_own(process, folder, ends) -> None:
    """So that the kill does not always strike the start."""
    before = ends[-1] if ends else -1
    for _ in range(10_000):
        if newest_step(folder) > before or process.exitcode is not None:
            return
        time.sleep(0.005)
