"""A run that is killed again and again ends as the one that was left alone."""

import json
import random
from dataclasses import replace

import pytest
import torch

import patience
import processes
from instok3d.training.checkpoint import KEPT, read_checkpoint
from instok3d.training.run_log import read_metrics
from processes import SERVER
from toy_stage import TINY

KILLS = 20
CALLS_OF_A_STEP = 17_000
"""About: calls, returns and exceptions from one checkpoint to the next."""
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
        if kills < KILLS:
            # The run of Python counts, not time: a busy machine would let the run end unkilled.
            anywhere = "call", rng.randint(1, 3 * CALLS_OF_A_STEP)
            in_a_file = rng.choice(["write", "open", "rename"]), rng.randint(1, 6)
            strike = anywhere if kills % 2 else in_a_file
        process = SERVER.Process(
            target=processes.train_toy_until_killed, args=(CONFIG, tmp_path / "killed", strike)
        )
        process.start()
        process.join(patience.SECONDS)
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
