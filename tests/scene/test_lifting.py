"""Semantics of new scenes: what an encoder sees in the photos comes with the scene."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

import instok3d
from edited_scenes import assert_consistent
from instok3d.cli import main
from instok3d.model.files import load_model
from instok3d.model.views.unseeded import without_patches
from instok3d.scene import lifting
from instok3d.scene.lifting import find_lifting
from instok3d.semantics.classes import PHRASES
from instok3d.semantics.files import save_semantics, tokenizer_digest
from instok3d.semantics.model import SemanticModel
from instok3d.semantics.predictor import Predictor, PredictorConfig
from instok3d.semantics.query.shipped import load_encoder
from instok3d.semantics.teachers.file import teacher_tensors
from instok3d.semantics.teachers.opening import open_teacher
from instok3d.semantics.teachers.rooms import RoomTeacher
from instok3d.semantics.text import quantized
from instok3d.semantics.tokens import SemanticTokensConfig
from instok3d.types import Views
from made_model import made_model, made_photos
from tiny_teachers import write_tiny_dino

CHANNELS = 12
SIZES = PredictorConfig(
    channels=CHANNELS, width=32, layers=1, head_width=16, quarter_channels=8, half_channels=8
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model, photos, and semantics of the model with random weights."""
    path = tmp_path_factory.mktemp("lifting")
    made_model(path / "model.safetensors")
    made_photos(path / "in")
    made_semantics_file(path / "model.safetensors", path / "semantics.safetensors")
    return path


def made_semantics_file(model: Path, path: Path, encoder: str = "rooms-made") -> None:
    tokenizer = load_model(model)
    torch.manual_seed(6)
    words = sorted({word for phrase in PHRASES for word in phrase.split()})
    table = quantized(torch.randn(len(words) + 1, CHANNELS), ("[UNK]", *words), "made")
    teacher = RoomTeacher(Predictor(SIZES), table, "rooms-made")
    config = SemanticTokensConfig(feature_channels=CHANNELS, residual_channels=2, group_layers=1)
    save_semantics(
        SemanticModel(tokenizer, config), path, encoder=encoder, card={},
        tokenizer_sha256=tokenizer_digest(tokenizer), beside=teacher_tensors(teacher),
    )  # fmt: skip


def made(folder: Path, semantics: str | Path, **options) -> instok3d.Scene:
    return instok3d.reconstruct(
        folder / "in", model=folder / "model.safetensors", semantics=semantics, **options
    )


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_scenes_come_with_semantics_and_are_the_same_scenes(folder: Path, tmp_path: Path):
    bare, scene = made(folder, "none"), made(folder, folder / "semantics.safetensors")
    for stage in ("gaussians", "tokens"):
        for name, value in vars(getattr(bare, stage)).items():
            assert torch.equal(value, getattr(getattr(scene, stage), name)), name
    assert bare.semantics == {}
    one = scene.semantics["rooms-made"]
    assert one.shared.shape == (5, 1, CHANNELS)
    assert one.residuals.shape == (len(scene.tokens.positions), 2)
    assert one.shared.flatten(1).any(dim=1).all()
    assert_consistent(scene)
    for item in scene.objects:
        assert item.label_source == "semantics:rooms-made"
        assert item.label in (*PHRASES, "unknown")
        assert item.key == f"{item.label}#{item.id}"
    assert [item.key for item in bare.objects] == [f"object#{item.id}" for item in bare.objects]
    scene.save(tmp_path / "room.itk")
    again = instok3d.load(tmp_path / "room.itk")
    assert torch.equal(again.semantics["rooms-made"].shared, one.shared)
    assert [item.key for item in again.objects] == [item.key for item in scene.objects]
    answers = again.query("chair", encoder=load_encoder(folder / "semantics.safetensors"))
    assert answers is not None
    vectors = again.semantics["rooms-made"].of_objects(
        [item.id for item in again.objects], again.tokens.assignment
    )
    assert torch.allclose(vectors.norm(dim=1), torch.ones(len(again.objects)), atol=1e-5)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_same_photos_give_the_same_semantics(folder: Path):
    first, same, fitted = (
        made(folder, folder / "semantics.safetensors", refine=n).semantics["rooms-made"]
        for n in (0, 0, 3)
    )
    for name, value in vars(first).items():
        assert torch.equal(value, getattr(same, name)), name
        # Refinement fits the directions of the shared features to the photos, nothing else.
        assert torch.equal(value, getattr(fitted, name)) or name == "shared", name
    torch.testing.assert_close(
        first.shared.norm(dim=2), fitted.shared.norm(dim=2), rtol=0.01, atol=0
    )
    assert not torch.equal(first.shared, fitted.shared)


def test_anchors_that_are_left_out_take_their_features_along(folder: Path):
    tokenizer = load_model(folder / "model.safetensors")
    found = find_lifting(folder / "semantics.safetensors", tokenizer, default=False)
    assert found is not None
    views = Views(images=torch.rand(1, 2, 3, 32, 32, generator=torch.Generator().manual_seed(1)))
    with torch.no_grad():
        groups = tokenizer(views, None, found.of(tokenizer, views, found.features(views)))
        patches = torch.zeros(2 * 16, dtype=torch.bool)
        patches[groups.anchors.patches[0, :3]] = True
        left = without_patches(groups, patches)
        kept = ~patches[groups.anchors.patches[0]]
        residuals = found.model.tokens(left).residuals
    assert len(residuals[0]) == int(kept.sum()) == len(kept) - 3
    assert torch.allclose(residuals[0], found.model.tokens(groups).residuals[0, kept], atol=1e-5)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_shared_features_point_to_what_is_seen_of_each_object(folder: Path):
    scene = made(folder, folder / "semantics.safetensors", refine=0)
    found = find_lifting(
        folder / "semantics.safetensors", load_model(folder / "model.safetensors"), default=False
    )
    assert found is not None
    features = torch.zeros(len(scene.views), CHANNELS, 64, 64)
    for axis, item in enumerate(scene.objects):  # each object is seen as an axis of its own
        for view, run_lengths in zip(item.visible_in, item.sight.masks, strict=True):
            mask = run_lengths.mask().float()[None, None]
            whole = torch.nn.functional.interpolate(mask, (64, 64))[0, 0] > 0
            features[view, axis][whole] = 2.0
    before = scene.semantics["rooms-made"].shared
    after = found.fitted(scene, features).semantics["rooms-made"].shared
    pixels = [sum(int(each.mask().sum()) for each in item.sight.masks) for item in scene.objects]
    seen = [item for item, count in zip(scene.objects, pixels, strict=True)
            if count >= lifting.MIN_PIXELS]  # fmt: skip
    assert seen
    for axis, item in enumerate(scene.objects):
        row = after[item.id - 1, 0]
        if item not in seen:
            assert torch.equal(row, before[item.id - 1, 0])
            continue
        assert int(row.argmax()) == axis
        assert float(row.norm()) == pytest.approx(float(before[item.id - 1, 0].norm()), rel=1e-2)
    # Of two shared features the mean is fitted, and they differ as before.
    apart = torch.randn(CHANNELS, generator=torch.Generator().manual_seed(2)).half().float()
    one = scene.semantics["rooms-made"]
    two = replace(
        one,
        shared=torch.cat([one.shared + apart, one.shared - apart], dim=1),
        mixing=torch.full((len(one.mixing), 2), 0.5),
    )
    pair = found.fitted(replace(scene, semantics={"rooms-made": two}), features)
    fit = pair.semantics["rooms-made"].shared
    torch.testing.assert_close(fit.mean(dim=1), after[:, 0], atol=4e-3, rtol=2e-3)
    away = (2 * apart).expand(len(fit), -1)
    torch.testing.assert_close(fit[:, 0] - fit[:, 1], away, atol=8e-3, rtol=4e-3)
    no_objects = replace(scene, objects=())
    kept = found.fitted(no_objects, features).semantics["rooms-made"].shared
    assert torch.equal(kept, before)


def test_what_does_not_belong_together_is_refused(folder: Path, tmp_path: Path):
    tokenizer = load_model(folder / "model.safetensors")
    with pytest.raises(FileNotFoundError, match="there are no semantics"):
        find_lifting(tmp_path / "none.safetensors", tokenizer, default=True)
    made_semantics_file(folder / "model.safetensors", tmp_path / "other.safetensors", "other")
    with pytest.raises(ValueError, match="lifts features of 'other', got the encoder 'rooms"):
        find_lifting(tmp_path / "other.safetensors", tokenizer, default=False)
    with torch.no_grad():
        next(iter(tokenizer.parameters())).add_(1)
    with pytest.raises(ValueError, match="belongs to another model"):
        find_lifting(folder / "semantics.safetensors", tokenizer, default=False)


def dino_semantics(folder: Path, path: Path) -> str:
    """Semantics that lift features of a tiny DINO, whose weights stay outside; how it is named."""
    weights = write_tiny_dino(path.parent / "tiny-dino")
    teacher = open_teacher(f"dino:{weights}")
    tokenizer = load_model(folder / "model.safetensors")
    config = SemanticTokensConfig(
        feature_channels=teacher.channels, residual_channels=2, group_layers=1
    )
    save_semantics(
        SemanticModel(tokenizer, config), path, encoder=teacher.name, card={},
        tokenizer_sha256=tokenizer_digest(tokenizer),
    )  # fmt: skip
    return f"dino:{weights}"


def test_an_encoder_of_others_lends_its_features_from_its_own_weights(folder: Path, tmp_path: Path):
    pytest.importorskip("transformers")
    path = tmp_path / "semantics.safetensors"
    teacher = dino_semantics(folder, path)
    with pytest.warns(UserWarning, match=r"no names: .* knows images alone"):
        scene = made(folder, path, teacher=teacher, refine=0)
    ((name, one),) = scene.semantics.items()
    assert name == open_teacher(teacher).name
    assert one.shared.flatten(1).any(dim=1).all()
    assert [item.key for item in scene.objects] == [f"object#{item.id}" for item in scene.objects]


def test_an_encoder_that_is_not_in_the_file_has_to_be_given(folder: Path, tmp_path: Path):
    pytest.importorskip("transformers")
    path = tmp_path / "semantics.safetensors"
    teacher = dino_semantics(folder, path)
    tokenizer = load_model(folder / "model.safetensors")
    with pytest.raises(ValueError, match="does not hold that encoder: give its weights"):
        find_lifting(path, tokenizer, default=False)
    own = folder / "semantics.safetensors"
    with pytest.raises(ValueError, match=r"'rooms-made', got the encoder .*weights that it was"):
        find_lifting(own, tokenizer, default=False, teacher=teacher)
    with pytest.raises(ValueError, match="goes with a file of semantics, got semantics 'auto'"):
        find_lifting("auto", tokenizer, default=True, teacher=teacher)
    same = find_lifting(own, tokenizer, default=False, teacher=f"rooms:{own}")
    assert same is not None
    assert same.encoder.teacher.name == "rooms-made"


def test_the_default_model_alone_has_what_comes_with_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    tokenizer = load_model(folder / "model.safetensors")
    monkeypatch.setattr(lifting, "SHIPPED", folder / "semantics.safetensors")
    assert find_lifting("auto", tokenizer, default=False) is None
    assert find_lifting("none", tokenizer, default=True) is None
    assert find_lifting("auto", tokenizer, default=True) is not None
    monkeypatch.setattr(lifting, "SHIPPED", tmp_path / "none.safetensors")
    assert find_lifting("auto", tokenizer, default=True) is None


def test_the_command_takes_a_file(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["reconstruct", str(folder / "in"), "-o", str(tmp_path / "room.itk"), "--refine", "0",
             "--model", str(folder / "model.safetensors"), "--semantics"]  # fmt: skip
    assert main([*words, str(tmp_path / "none.safetensors")]) == 2
    assert "there are no semantics" in capsys.readouterr().err
    assert not (tmp_path / "room.itk").exists()
    assert main([*words, str(folder / "semantics.safetensors")]) == 0
    assert "rooms-made" in instok3d.load(tmp_path / "room.itk").semantics


def test_nothing_is_known_of_a_group_without_features(folder: Path):
    scene = replace(made(folder, folder / "semantics.safetensors", refine=0))
    one = scene.semantics["rooms-made"]
    bare = replace(scene, semantics={"rooms-made": replace(one, shared=0 * one.shared)})
    known, pi = bare.semantics["rooms-made"], bare.tokens.assignment
    assert known.of_objects([1, 2], pi).eq(0).all()
    assert known.of_objects([], pi).shape == (0, CHANNELS)
