from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from fake_rooms import FakeRooms
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.cli import main
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample, photos_only
from instok3d.data.words import ObjectWords
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.semantics.files import load_semantics, save_semantics, tokenizer_digest
from instok3d.semantics.predictor import Predictor, PredictorConfig
from instok3d.semantics.targets import target_map
from instok3d.semantics.teachers.file import load_teacher, save_teacher
from instok3d.semantics.teachers.rooms import RoomTeacher
from instok3d.semantics.text import load_table, quantized, save_table
from instok3d.semantics.tokens import SemanticTokensConfig
from instok3d.training.stages.answers import AveragedRun
from instok3d.training.stages.semantics import SemanticRun, SemanticsStage, SemanticsStageConfig

NAMES = ("cabinet", "bed", "table", "wall", "floor", "red", "wood")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("table") / "table.safetensors"
    generator = torch.Generator().manual_seed(2)
    vectors = torch.randn(len(NAMES) + 1, 16, generator=generator)
    save_table(quantized(vectors, ("[UNK]", *NAMES), "made"), path)
    return path


@pytest.fixture(scope="module")
def tiny(table: Path) -> SemanticsStageConfig:
    return SemanticsStageConfig(
        backbone=NanoConfig(width=64, layers=1),
        tokenizer=TokenizerConfig(
            width=64, num_anchors=8, num_groups=4, anchor_layers=1, group_layers=1,
            gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
        ),
        tokens=SemanticTokensConfig(feature_channels=16, residual_channels=2, group_layers=1),
        teacher=f"words:{table}",
    )  # fmt: skip


@pytest.fixture(scope="module")
def sample() -> Sample:
    batch = SceneBatches(FakeRooms(2, size=32), [0, 1], BatchConfig(2), seed=0).batch(0)
    words = {number: ObjectWords(NAMES[number % 5], "red", "wood")
             for number in batch.target_instances.unique().tolist() if number > 0}  # fmt: skip
    return replace(batch, words=(words, words))


@pytest.fixture
def stage(tiny: SemanticsStageConfig) -> SemanticsStage:
    return SemanticsStage(tiny)


@pytest.fixture
def model(stage: SemanticsStage) -> SemanticRun:
    torch.manual_seed(0)
    return stage.build_model()


def test_features_learn_on_a_tokenizer_that_stays(stage, model, sample):
    before = {name: value.clone() for name, value in model.tokenizer.state_dict().items()}
    learning = [value for value in model.parameters() if value.requires_grad]
    assert len(learning) == len(list(model.semantic.parameters()))
    optimizer = torch.optim.Adam(learning, 5e-3)
    losses = []
    for step in range(25):
        loss = stage.loss(model, sample, step)
        assert torch.equal(loss.total.detach(), loss.terms["pixels"] + loss.terms["groups"])
        optimizer.zero_grad()
        loss.total.backward()
        assert all(value.grad is not None and value.grad.isfinite().all() for value in learning)
        optimizer.step()
        losses.append(loss.total.item())
    assert losses[-1] < 0.6 * losses[0]
    assert all(torch.equal(value, before[n]) for n, value in model.tokenizer.state_dict().items())


def test_the_same_batch_has_the_same_loss(stage, model, sample):
    assert torch.equal(
        stage.loss(model, sample, 0).total.detach(), stage.loss(model, sample, 9).total.detach()
    )


def test_a_scene_that_says_what_the_teacher_says_has_no_loss(stage, model, sample, table):
    # One word for everything: every group has it, and the residuals are nothing.
    words = {number: ObjectWords("bed") for number in range(1, 99)}
    ids = torch.ones_like(sample.target_instances)
    whole = replace(
        sample, words=(words, words), target_instances=ids,
        context_instances=torch.ones_like(sample.context_instances),
    )  # fmt: skip
    wanted = target_map(ids[0, 0], words, stage.teacher.table)[0][:, 0, 0]
    with torch.no_grad():
        model.semantic.decoder.shared.weight.zero_()
        model.semantic.decoder.shared.bias.copy_(wanted)
        model.semantic.decoder.residual_map.weight.zero_()
    figures = stage.validate(model, [whole])
    # Pixels without any Gaussian have no feature.
    seen = stage._distil(model, whole).features.any(dim=2).float().mean().item()
    assert seen > 0.5
    assert figures["cosine_pixels"] == pytest.approx(seen, abs=1e-3)
    assert figures["cosine_shared"] == pytest.approx(seen, abs=1e-3)
    assert figures["cosine_groups"] == pytest.approx(1, abs=1e-3)


def test_pictures_show_each_sample(stage, model, sample):
    with torch.no_grad():
        assert stage.pictures(model, sample).height > 2 * 32


def test_settings_that_do_not_fit_are_refused(tiny: SemanticsStageConfig, tmp_path: Path):
    wrong = replace(tiny, tokens=replace(tiny.tokens, feature_channels=32))
    with pytest.raises(ValueError, match="has 16 channels, not 32: set --stage"):
        wrong.build()
    for teacher in ("", "words", "words:", "nonsense:x"):
        with pytest.raises(ValueError, match="names no teacher; wanted is one of words:TABLE, "):
            replace(tiny, teacher=teacher).build()
    with pytest.raises(FileNotFoundError, match="there is no text table"):
        replace(tiny, teacher=f"words:{tmp_path / 'none'}").build()


def test_an_exported_file_serves_its_tokenizer_alone(
    tiny: SemanticsStageConfig, model: SemanticRun, sample: Sample, tmp_path: Path
):
    file = tmp_path / "semantics.safetensors"
    card = {"steps": 3, "config": {"seed": 5, "stage": {"teacher": tiny.teacher, "know": 1}}}
    tiny.export(AveragedRun(tmp_path, model.state_dict(), card), file, half=False)
    loaded = load_semantics(file, model.tokenizer)
    assert loaded.encoder == "true-words"
    no_folder = f"words:{Path(tiny.teacher).name}"
    stage = {"teacher": no_folder, "know": 1, "start_from": ""}
    wanted = {"steps": 3, "config": {"seed": 5, "stage": stage}}
    assert loaded.card == wanted
    photos = photos_only(sample.context)
    features = torch.randn(2, 2, 16, 16, 16, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found = loaded.model(model.tokenizer, photos, features)[1]
        wanted = model.semantic.eval()(model.tokenizer, photos, features)[1]
    assert torch.equal(found.shared, wanted.shared)
    assert torch.equal(found.residuals, wanted.residuals)

    torch.manual_seed(1)
    other = tiny.new_model().tokenizer
    assert tokenizer_digest(other) != tokenizer_digest(model.tokenizer)
    with pytest.raises(ValueError, match="belongs to another model"):
        load_semantics(file, other)
    halved = model.tokenizer.half().float()
    assert tokenizer_digest(halved) == tokenizer_digest(model.tokenizer)


def test_a_run_begins_with_a_file_of_semantics(
    tiny: SemanticsStageConfig, model: SemanticRun, tmp_path: Path
):
    file = tmp_path / "semantics.safetensors"
    digest = tokenizer_digest(model.tokenizer)
    save_semantics(model.semantic, file, encoder="made", tokenizer_sha256=digest, card={},
                   half=False)  # fmt: skip
    begun = replace(tiny, start_from=str(file), tokens=replace(tiny.tokens, num_basis=2)).build()
    torch.manual_seed(7)
    run = begun.build_model()
    begun.load_initial(run, model.tokenizer.state_dict())
    rows = model.semantic.decoder.shared.weight
    assert torch.equal(run.semantic.decoder.shared.weight, torch.cat([rows, rows]))
    with pytest.raises(ValueError, match="give one of them, or a tokenizer to --init-from"):
        begun.load_initial(run, run.state_dict())
    missing = replace(tiny, start_from=str(tmp_path / "none")).build()
    with pytest.raises(FileNotFoundError, match="there are no semantics"):
        missing.load_initial(missing.build_model(), model.tokenizer.state_dict())


def test_the_encoder_of_rooms_goes_along(
    tiny: SemanticsStageConfig, model: SemanticRun, sample: Sample, table: Path, tmp_path: Path
):
    sizes = PredictorConfig(
        channels=16, width=32, layers=1, head_width=16, quarter_channels=8, half_channels=8
    )
    torch.manual_seed(3)
    teacher = RoomTeacher(Predictor(sizes), load_table(table), "rooms-made")
    save_teacher(teacher, tmp_path / "teacher.safetensors")
    config = replace(tiny, teacher=f"rooms:{tmp_path / 'teacher.safetensors'}")
    for enabled in (False, True):
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            assert config.build().loss(model, sample, 0).total.isfinite()
    file = tmp_path / "semantics.safetensors"
    config.export(AveragedRun(tmp_path, model.state_dict(), {}), file, half=True)
    assert load_semantics(file, model.tokenizer).encoder == "rooms-made"
    photos = sample.context.images[0]
    again = load_teacher(tmp_path / "teacher.safetensors").features(photos)
    assert torch.equal(load_teacher(file).features(photos), again)


def test_damaged_semantics_are_named(model: SemanticRun, tmp_path: Path):
    file = tmp_path / "semantics.safetensors"
    digest = tokenizer_digest(model.tokenizer)
    about = {"encoder": "made", "tokenizer_sha256": digest, "card": {}}
    with pytest.raises(FileNotFoundError, match="there are no semantics"):
        load_semantics(file, model.tokenizer)
    save_semantics(model.semantic, file, **about)
    assert load_semantics(file, model.tokenizer).encoder == "made"
    with safe_open(file, "pt") as stream:
        metadata = stream.metadata()
    weights = load_file(file)
    first = "semantic.decoder.query.bias"
    damage = {
        "are not those of its sizes": ({k: v for k, v in weights.items() if k != first}, {}),
        "is not finite": (weights | {first: weights[first] / 0}, {}),
        "holds no semantics of format": (weights, {"semantic.format": "other"}),
        "is damaged": (weights, {"semantic.config": "{"}),
        "its levels of SemanticTokensConfig": (
            weights,
            {"semantic.config": metadata["semantic.config"].replace("group and", "no")},
        ),
        "sizes that this version does not know": (weights, {"semantic.config": '{"size": 1}'}),
    }
    # Files of before the levels were there have both.
    before = metadata["semantic.config"].replace(', "levels": "group and anchor"', "")
    assert before != metadata["semantic.config"]
    save_file(weights, file, metadata | {"semantic.config": before})
    assert (
        load_semantics(file, model.tokenizer).model.decoder.config == model.semantic.decoder.config
    )
    for message, (changed, more) in damage.items():
        save_file(changed, file, metadata | more)
        with pytest.raises(ValueError, match=message):
            load_semantics(file, model.tokenizer)
    with torch.no_grad():
        model.semantic.decoder.query.bias.fill_(1e6)
    with pytest.raises(ValueError, match="not finite in float16"):
        save_semantics(model.semantic, tmp_path / "other.safetensors", **about)
    assert not (tmp_path / "other.safetensors").exists()


def test_runs_are_planned(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        "instok3d.cli.train_runs.open_training_scenes",
        lambda folder, masks=None: FakeRooms(40, size=16),
    )
    for name in ("nano-semantics", "scannet-semantics"):
        assert main(["train", name, "--data", "rooms", "--dry-run"]) == 0
        lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
        assert lines["stage"] == "semantics"
        assert "a trained tokenizer" in lines["missing"]
