from pathlib import Path

import pytest

import instok3d
from instok3d.cli import main
from shipped_demo import PHOTOS, ShippedDemo, is_shipped


def test_demo_finds_objects_in_the_shipped_photos(shipped_demo: ShippedDemo):
    made = shipped_demo.made
    assert {"geometry", "tokens", "previews"} <= made["timings_s"].keys()
    assert len(made["objects"]) >= 3
    assert shipped_demo.notes.count("trained on rendered rooms alone") == 1
    scene = instok3d.load(shipped_demo.scene)
    assert any("trained on rendered rooms alone" in line for line in scene.warnings)
    difference = scene.render().colors - scene.photos.permute(0, 3, 1, 2) / 255
    assert float(-10 * difference.square().mean().log10()) > 15


def test_the_shipped_photos_are_small():
    if not is_shipped():
        pytest.skip("the default model and the demo's photos are not in this tree")
    assert sum(file.stat().st_size for file in PHOTOS.iterdir()) < 1_000_000


def test_a_demo_without_weights_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    nothing = tmp_path / "nothing.safetensors"
    monkeypatch.setattr("instok3d.model.files.DEFAULT_MODEL", nothing)
    code, message = (
        (4, "the default model is not") if PHOTOS.is_dir() else (2, "photos are missing")
    )
    assert main(["demo", "-o", str(tmp_path / "demo.itk")]) == code
    assert message in capsys.readouterr().err
    assert not (tmp_path / "demo.itk").exists()
