from pathlib import Path

import pytest

from instok3d.backbones.cost import Work
from instok3d.cli import main
from instok3d.model import memory
from instok3d.model.files import read_sizes
from instok3d.model.memory import predict_peak_bytes
from made_model import made_model, made_photos


def test_reconstruct_refuses_before_loading_and_names_a_count_that_then_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    model = made_model(tmp_path / "random.safetensors", image_side=128)
    needed = [predict_peak_bytes(*read_sizes(model), Work(n, 128, 128)) for n in (1, 2, 3)]
    assert needed[0] < needed[1] < needed[2]
    monkeypatch.setattr(memory, "available_bytes", lambda device: needed[1])
    monkeypatch.setattr(memory, "resident_bytes", lambda: 0)
    photos = made_photos(tmp_path / "photos", 3)
    words = ["reconstruct", str(photos), "-o", str(tmp_path / "room.itk"), "--model", str(model)]
    with monkeypatch.context() as patch:
        patch.setattr("instok3d.scene.reconstruct.load_model", lambda path: pytest.fail("loaded"))
        assert main(words) == 3
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith("instok3d: 3 views of 128 x 128 pixels are predicted to need 0.3")
    assert lines[-1].endswith("2 views would fit: give max_views (--max-views)")
    assert not (tmp_path / "room.itk").exists()
    assert main([*words, "--max-views", "2"]) == 0
