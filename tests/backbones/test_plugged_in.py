"""A backbone of somebody else goes the whole way: plan, train, go on, export, load, reconstruct."""

import pytest
import torch
from safetensors.torch import save_file

import instok3d
from fake_rooms import FakeRooms
from instok3d.cli import main
from instok3d.data.batches import make_sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.evaluation.protocols import ProtocolScene
from instok3d.evaluation.run import EvaluationSettings, evaluate
from instok3d.model.files import load_model, read_card, read_unit
from instok3d.training.config import read_config
from made_model import made_photos
from plane_backbone import PlaneBackbone, PlaneConfig

SMALL = [
    "--batches.batch-size", "1", "--batches.views", "2", "--holdout", "1", "--threads", "1",
    "--stage.tokenizer.width", "32", "--stage.tokenizer.head-size", "16",
    "--stage.tokenizer.num-anchors", "16", "--stage.tokenizer.num-groups", "4",
    "--stage.tokenizer.anchor-layers", "1", "--stage.tokenizer.group-layers", "1",
    "--stage.target-cameras", "true",
]  # fmt: skip
"""Settings of nano-tokenizer that take a second."""

pytestmark = pytest.mark.filterwarnings("ignore:how much memory a PlaneBackbone takes")


@pytest.fixture
def run(tmp_path, monkeypatch, plane) -> list[str]:
    """The command of a run on made rooms, from made weights of the plane."""
    monkeypatch.setattr(
        "instok3d.cli.train_runs.open_training_scenes",
        lambda folder, masks=None: FakeRooms(3, size=32),
    )
    torch.manual_seed(0)
    save_file(PlaneBackbone(PlaneConfig()).state_dict(), tmp_path / "plane.safetensors")
    words = ["train", "nano-tokenizer", "--data", "rooms", "--backbone", plane]
    return [*words, "--init-from", str(tmp_path / "plane.safetensors")]


def test_a_registered_backbone_is_trained_exported_and_used(run, tmp_path, capsys):
    assert main([*run, *SMALL, "--dry-run"]) == 0
    assert "missing        nothing" in capsys.readouterr().out

    folder, file = tmp_path / "run", tmp_path / "model.safetensors"
    assert main([*run, *SMALL, "-o", str(folder), "--steps", "1"]) == 0
    assert read_config(folder).stage.backbone == PlaneConfig()
    assert main([*run[:-4], "-o", str(folder), "--resume", "--steps", "2"]) == 0
    assert main(["train", "export", str(folder), "-o", str(file), "--float32"]) == 0
    assert read_card(file)["steps"] == 2
    assert read_unit(file) == "metre"

    model = load_model(file)
    assert isinstance(model.backbone, PlaneBackbone)
    given = torch.load(folder / "checkpoints" / "step_00000002.pt", weights_only=True)["model"]
    assert torch.equal(model.backbone.stem.weight, given["backbone.stem.weight"])

    photos = made_photos(tmp_path / "photos")
    words = ["reconstruct", str(photos), "-o", str(tmp_path / "room.itk"), "--model", str(file)]
    assert main(words) == 0
    scene = instok3d.load(tmp_path / "room.itk")
    assert scene.render().colors.isfinite().all()


def test_a_registered_backbone_is_measured(run, tmp_path):
    assert main([*run, *SMALL, "-o", str(tmp_path / "run"), "--steps", "0"]) == 0
    file = tmp_path / "model.safetensors"
    assert main(["train", "export", str(tmp_path / "run"), "-o", str(file)]) == 0
    sample = make_sample(FakeRooms(1, size=32), 0, FrameChoice((3, 5), (4,)))
    report = evaluate(
        load_model(file),
        [ProtocolScene("0", "easy", (sample,))],
        EvaluationSettings(geometry="intrinsics", model_unit=read_unit(file)),
        protocol="rooms-2view",
        model_name="plane",
    )
    assert report.true_targets == 1
    assert report.figures.psnr is not None


def test_a_run_on_a_backbone_that_is_not_registered_is_refused(run, tmp_path, capsys):
    wrong = [word if word != "plane" else "plain" for word in run]
    assert main([*wrong, *SMALL, "-o", str(tmp_path / "run")]) == 2
    assert "no backbone is called 'plain'; there are" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_stage_of_the_nano_backbone_trains_no_other(tmp_path, capsys, plane):
    words = ["train", "nano-geometry", "--data", "rooms", "--backbone", plane]
    assert main([*words, "-o", str(tmp_path / "run")]) == 2
    assert (
        "has losses for a backbone of its own, it cannot train 'plane'" in capsys.readouterr().err
    )


def test_a_run_whose_backbone_is_gone_says_so(run, tmp_path, monkeypatch):
    assert main([*run, *SMALL, "-o", str(tmp_path / "run"), "--steps", "0"]) == 0
    monkeypatch.setattr("instok3d.backbones.registry._REGISTERED", {})
    with pytest.raises(ValueError, match="no backbone is made from a PlaneConfig"):
        read_config(tmp_path / "run")
