"""The command as torchrun starts it: two processes, one record, and going on alone."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import patience
from flat_rooms import flat_room
from instok3d.cli import main
from instok3d.files import write_json
from instok3d.rooms.scene import RenderedScene
from instok3d.rooms.shards import ShardRecord, add_to_index, new_index, write_shard
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.run_log import read_metrics

TRAIN = [
    "train", "nano-geometry", "--stage.backbone.width", "64", "--stage.backbone.layers", "1",
    "--batches.batch-size", "1", "--batches.views", "2", "--holdout", "1", "--threads", "1",
    "--log-every-steps", "1",
]  # fmt: skip


def write_rooms(folder: Path, count: int) -> None:
    folder.mkdir()
    write_json(folder / "rooms.json", new_index(32, "mix"))
    scenes = [
        RenderedScene(
            images=room.images,
            instances=room.instances.astype(np.uint16),
            depths_mm=(room.depths_m * 1000).astype(np.uint16),
            world_from_cam=room.world_from_cam.astype(np.float32),
            intrinsics=room.intrinsics.astype(np.float32),
            meta=room.meta,
        )
        for room in map(flat_room, range(count))
    ]
    write_shard(folder / "rooms-0000000.safetensors", scenes)
    add_to_index(folder, 0, ShardRecord(list(range(count)), [], ["easy"] * count))


@pytest.mark.slow
def test_two_processes_leave_one_record_and_one_goes_on(tmp_path, capsys):
    write_rooms(tmp_path / "rooms", 4)
    run = [*TRAIN, "--data", str(tmp_path / "rooms"), "-o", str(tmp_path / "run")]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    done = subprocess.run(
        [*torchrun, "--nproc-per-node", "2", "-m", "instok3d", *run, "--steps", "2"],
        capture_output=True,
        text=True,
        timeout=patience.SECONDS,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"step": 2, "ended": "finished"}
    assert "2 processes" in done.stderr

    assert main([*run, "--resume", "--steps", "3"]) == 0
    assert json.loads(capsys.readouterr().out) == {"step": 3, "ended": "finished"}
    assert read_checkpoint(tmp_path / "run")["step"] == 3
    lines = read_metrics(tmp_path / "run" / "metrics.jsonl")
    assert [line["step"] for line in lines if line["kind"] == "train"] == [1, 2, 3]
