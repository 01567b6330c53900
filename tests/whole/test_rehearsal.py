"""runs/rehearsal.sh at its small size: ScanNet files to figures, through every command between."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from instok3d.evaluation.report import KEYS
from instok3d.model.files import load_model, read_card
from instok3d.training.run_log import read_metrics

SCRIPT = Path(__file__).resolve().parents[2] / "runs" / "rehearsal.sh"


FOUR_ROOMS = """
import sys
from instok3d.cli import main
from instok3d.rooms import generate
generate.SHARD_SEEDS = 4
sys.exit(main())
"""
"""Rooms are made by whole shards of 16; the small size wants four."""


def with_commands(folder: Path) -> dict[str, str]:
    """An environment in which `instok3d`, `python` and `torchrun` are those of this Python."""
    folder.mkdir()
    (folder / "four_rooms.py").write_text(FOUR_ROOMS)
    rooms = f'[ "$1 $2" != "data rooms" ] || exec "{sys.executable}" "{folder}/four_rooms.py" "$@"'
    for name, lines in {
        "instok3d": f'{rooms}\nexec "{sys.executable}" -m instok3d "$@"',
        "python": f'exec "{sys.executable}" "$@"',
        "torchrun": f'exec "{sys.executable}" -m torch.distributed.run "$@"',
    }.items():
        command = folder / name
        command.write_text(f"#!/usr/bin/env bash\n{lines}\n")
        command.chmod(0o755)
    # The sources are found where this process finds them, installed or not.
    return os.environ | {
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        "OMP_NUM_THREADS": "1",
    }


@pytest.mark.slow
def test_scannet_files_become_a_model_and_its_figures(tmp_path: Path):
    folder = tmp_path / "rehearsal"
    ended = subprocess.run(
        ["bash", SCRIPT, folder, "--small"],
        env=with_commands(tmp_path / "bin"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr[-4000:]
    assert "killed 3 processes" in ended.stderr  # torchrun and its two

    scenes = json.loads((folder / "prepared" / "scenes.json").read_text())["scenes"]
    assert sorted({entry["split"] for entry in scenes.values()}) == ["test", "train"]
    steps = [row["step"] for row in read_metrics(folder / "tokenizer" / "metrics.jsonl")]
    assert steps[-1] == 4
    saved = sorted(path.name for path in (folder / "tokenizer" / "checkpoints").iterdir())
    assert any("00000004" in name for name in saved)

    figures = json.loads((folder / "scannet-2view.json").read_text())
    assert set(figures) >= {"protocol", "model", "scenes", *KEYS}
    assert (figures["protocol"], figures["scenes"]) == ("scannet-2view", 1)
    for key in ("psnr", "ap50", "rotation_deg", "depth_rel"):
        assert figures[key] is not None, key
    model = load_model(folder / "model.safetensors")
    assert sum(p.numel() for p in model.backbone.parameters()) > 1e6
    assert read_card(folder / "model.safetensors")["steps"] == 4
