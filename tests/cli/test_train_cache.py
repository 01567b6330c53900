import json
from pathlib import Path

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.cli import main
from instok3d.files import write_safetensors

SETTINGS = [
    "--data", "rooms", "--stage.backbone.width", "64", "--stage.backbone.layers", "1",
    "--batches.views", "2", "--batches.batch-size", "1", "--holdout", "1", "--threads", "1",
]  # fmt: skip


@pytest.fixture(autouse=True)
def rooms(monkeypatch: pytest.MonkeyPatch) -> None:
    for place in ("train_runs", "train_cache"):
        monkeypatch.setattr(
            f"instok3d.cli.{place}.open_training_scenes",
            lambda folder, masks=None: FakeRooms(2, size=32),
        )


def test_a_cache_is_filled_gone_on_with_and_refused_where_it_does_not_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    torch.manual_seed(0)
    backbone = NanoBackbone(NanoConfig(width=64, layers=1))
    write_safetensors(tmp_path / "backbone.safetensors", backbone.state_dict())
    fill = ["train", "cache", "-o", str(tmp_path / "cache"), *SETTINGS]
    fill += ["--init-from", str(tmp_path / "backbone.safetensors")]
    assert main(fill) == 2
    assert "set batches.samples_per_scene" in capsys.readouterr().err

    fill += ["--batches.samples-per-scene", "2"]
    assert main(fill) == 0
    first = json.loads(capsys.readouterr().out)
    assert (first["scenes"], first["made"], first["samples"]) == (2, 2, 3)
    assert main(fill) == 0
    assert json.loads(capsys.readouterr().out) == first | {"made": 0, "samples": 0}

    assert main([*fill, "--seed", "1"]) == 2
    assert "begun with other settings (seed: made with 0, wanted 1)" in capsys.readouterr().err
    assert main([*fill, "--preset", "no-such"]) == 2
    assert "no preset 'no-such'" in capsys.readouterr().err

    write_safetensors(tmp_path / "other.safetensors", {"x": torch.ones(1)})
    assert main([*fill, "--init-from", str(tmp_path / "other.safetensors")]) == 2
    assert "do not fit the backbone of the run" in capsys.readouterr().err
    if not torch.cuda.is_available():
        assert main([*fill, "--device", "cuda"]) == 2
        assert "torch sees no CUDA device" in capsys.readouterr().err

    run = ["train", "nano-tokenizer", "-o", str(tmp_path / "run"), *SETTINGS]
    run += ["--stage.cache", str(tmp_path / "cache"), "--batches.samples-per-scene", "1"]
    assert main(run) == 2
    assert "batches.samples_per_scene: made with 2, wanted 1" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
