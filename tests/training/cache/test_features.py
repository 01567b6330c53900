"""Training on cached features is training on the backbone, up to float16; misfits are refused."""

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.backbones.base import GeometryBackbone, Prediction, settle_geometry
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample, collate, photos_only
from instok3d.data.sensor import SensorConfig
from instok3d.locking import alone_in
from instok3d.model.files import load_model
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.training.cache.features import FeatureCache, scene_path
from instok3d.training.cache.settings import check_cache
from instok3d.training.cache.writing import fill_cache
from instok3d.training.config import TrainConfig, preset
from instok3d.training.export import export_model
from instok3d.training.held_out import validation_samples
from instok3d.training.loop import train
from instok3d.training.stages.tokenizer import TokenizerStage, TokenizerStageConfig
from instok3d.types import Geometry, Views
from kill_points import every_kill
from plane_backbone import PlaneBackbone, PlaneConfig

SIZES = TokenizerConfig(
    width=64,
    num_anchors=16,
    num_groups=4,
    anchor_layers=1,
    group_layers=1,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=16),
)
BACKBONE = NanoConfig(width=64, layers=1)
STAGE = TokenizerStageConfig(backbone=BACKBONE, tokenizer=SIZES)
CONFIG = replace(
    preset("nano-tokenizer"),
    stage=STAGE,
    batches=BatchConfig(batch_size=2, views=(2, 3), samples_per_scene=2),
    holdout=1,
    steps=2,
    amp=False,
)
ROOMS = FakeRooms(4, size=32)
FEW = FakeRooms(2, size=32)
ONE_SAMPLE = replace(CONFIG.batches, views=(2,), samples_per_scene=1)
QUICK = replace(CONFIG, stage=replace(STAGE, given_probability=1.0), batches=ONE_SAMPLE)
"""One sample a scene, where it does not matter what the features are."""


def backbone_weights(seed: int = 0) -> dict[str, torch.Tensor]:
    torch.manual_seed(seed)
    return NanoBackbone(BACKBONE).state_dict()


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cache")
    filled = fill_cache(CONFIG, ROOMS, folder, backbone_weights())
    # 3 training scenes x 2 numbers of views x 2 samples, and 1 held-out scene x 1 protocol.
    assert (filled.scenes, filled.made, filled.samples) == (4, 4, 13)
    return folder


@pytest.fixture(scope="module")
def quick_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("quick")
    assert fill_cache(QUICK, ROOMS, folder, backbone_weights()).samples == 4
    return folder


def with_cache(config: TrainConfig, folder: Path) -> TrainConfig:
    assert isinstance(config.stage, TokenizerStageConfig)
    return replace(config, stage=replace(config.stage, cache=folder))


def stages(folder: Path) -> tuple[TokenizerStage, TokenizerStage]:
    cached = with_cache(CONFIG, folder).stage
    assert isinstance(cached, TokenizerStageConfig)
    return TokenizerStage(STAGE), TokenizerStage(cached)


def true_backbone() -> NanoBackbone:
    backbone = NanoBackbone(BACKBONE)
    backbone.load_state_dict(backbone_weights())
    return backbone.eval()


def filled_batches(scenes: list[int], views: int) -> list[Sample]:
    """The training samples of some scenes, in the batches in which `fill_cache` takes them.

    No BLAS promises the same bits in other batches, and the cameras that an untrained backbone
    solves for change a lot with the last bit.
    """
    batches = SceneBatches(ROOMS, [1, 2, 3], CONFIG.batches, seed=CONFIG.seed)
    samples = [batches.fixed_sample(scene, views, which) for scene in scenes for which in (0, 1)]
    size = 2 * CONFIG.batches.batch_size // views
    return [collate(samples[k : k + size]) for k in range(0, len(samples), size)]


HALF = 2**-11
"""The largest relative error of rounding to float16."""


@pytest.mark.parametrize("views", [2, 3])
@torch.no_grad()
def test_the_geometry_is_what_the_backbone_says_up_to_float16(cache: Path, views: int):
    backbone, batches = true_backbone(), filled_batches([3, 1, 2], views)
    for given, told in ((False, False), (False, True), (True, False)):
        found = FeatureCache(cache).geometry(collate(batches), given=given, intrinsics=told)
        for batch in batches:
            shown = batch.context if given else photos_only(batch.context, keep_intrinsics=told)
            expected = backbone(shown)
            here, found = split_after(found, len(batch.keys))
            torch.testing.assert_close(here.features, expected.features, rtol=HALF, atol=1e-6)
            torch.testing.assert_close(vars(here.cameras), vars(expected.cameras))
            half = 0 if given else HALF  # depth that is given is not in the cache
            torch.testing.assert_close(here.depths, expected.depths, rtol=half, atol=1e-6)
            moved = (here.pointmaps - expected.pointmaps).norm(dim=-1)
            # A ray of unit depth is at most 1.5 long.
            assert (moved < 1.5 * half * expected.depths + 1e-5).all()
            if not given:
                torch.testing.assert_close(
                    here.confidences, expected.confidences, rtol=HALF, atol=0
                )


def split_after(geometry: Geometry, count: int) -> tuple[Geometry, Geometry]:
    """The first scenes of a batch, and the others."""
    return geometry.map(lambda t: t[:count]), geometry.map(lambda t: t[count:])


class RoundedBackbone(GeometryBackbone):
    """Rounds the answers of a backbone to float16, as a cache does."""

    def __init__(self, backbone: NanoBackbone) -> None:
        super().__init__()
        self.backbone = backbone
        self.patch_size, self.feature_channels = backbone.patch_size, backbone.feature_channels

    def forward(self, views: Views) -> Geometry:
        answer = self.backbone(photos_only(views, keep_intrinsics=views.intrinsics is not None))
        prediction = Prediction(
            features=answer.features.half().float(),
            depths=answer.depths.half().float(),
            confidences=answer.confidences.half().float(),
            **vars(answer.cameras),
        )
        return settle_geometry(views, prediction)


@pytest.mark.parametrize("amp", [False, True])
def test_steps_and_gradients_are_those_of_the_rounded_backbone_in_every_mode(
    cache: Path, tmp_path: Path, amp: bool
):
    """Of the rounded one, because a step is not smooth: other anchors make another gradient.

    Under autocast the cache must be filled under autocast too: the untrained backbone then solves
    for quite different cameras.
    """
    if amp:
        cache = tmp_path
        fill_cache(replace(CONFIG, amp=True), FEW, cache, backbone_weights())
    uncached, cached = stages(cache)
    torch.manual_seed(1)
    full, light = uncached.build_model(), cached.build_model()
    own = {k: v for k, v in full.state_dict().items() if not k.startswith("backbone.")}
    assert not light.load_state_dict(own, strict=False).unexpected_keys
    assert not list(light.backbone.parameters())
    full.backbone, modes = RoundedBackbone(true_backbone()), set()
    for step, views in ((0, 2), (1, 3), (4, 2)):  # photos alone, with intrinsics, with all given
        sample = filled_batches([1], views)[0]
        full.zero_grad(), light.zero_grad()
        with torch.autocast("cpu", torch.bfloat16, enabled=amp):
            expected, found = uncached.loss(full, sample, step), cached.loss(light, sample, step)
        modes |= {name for name in found.terms if name.startswith("mse")}
        torch.testing.assert_close(found.total, expected.total)
        expected.total.backward()
        found.total.backward()
        for name, parameter in light.named_parameters():
            other = full.get_parameter(name).grad
            assert (parameter.grad is None) == (other is None)
            if parameter.grad is not None and other is not None:
                assert (parameter.grad - other).norm() <= 1e-4 * other.norm(), name
    assert modes == {"mse_given", "mse_predicted"}


def test_a_run_without_its_backbone_validates_resumes_and_is_exported_whole(
    cache: Path, tmp_path: Path
):
    config = with_cache(CONFIG, cache)
    assert isinstance(config.stage, TokenizerStageConfig)
    check_cache(FeatureCache(cache), config, ROOMS)
    train(replace(config, steps=1), TokenizerStage(config.stage), ROOMS, tmp_path)
    train(config, TokenizerStage(config.stage), ROOMS, tmp_path, resume=True)
    saved = torch.load(next(tmp_path.glob("checkpoints/*2.pt")), weights_only=True)["model"]
    assert [name for name in saved if name.startswith("backbone.")] == ["backbone.weights_sha256"]
    export_model(tmp_path, tmp_path / "model.safetensors", half=False)
    exported = load_model(tmp_path / "model.safetensors").backbone.state_dict()
    for name, value in backbone_weights().items():
        assert torch.equal(exported[name], value)


def test_only_the_backbone_of_the_cache_is_taken_as_first_weights(cache: Path):
    _, stage = stages(cache)
    model = stage.build_model()
    stage.load_initial(model, backbone_weights())
    with pytest.raises(ValueError, match=r"weights sha256:.* were made by sha256:"):
        stage.load_initial(model, backbone_weights(seed=1))
    torch.manual_seed(2)
    whole = TokenizerStage(STAGE)
    other = whole.build_model()
    whole.load_initial(other, backbone_weights())
    stage.load_initial(model, other.state_dict())
    assert torch.equal(model.fuse.color_proj.weight, other.fuse.color_proj.weight)


def test_a_run_does_not_go_on_with_features_of_another_backbone(cache: Path, tmp_path: Path):
    fill_cache(QUICK, FEW, tmp_path, backbone_weights(seed=1))
    state = stages(cache)[1].build_model().state_dict()
    with pytest.raises(ValueError, match="begun with the features of another backbone"):
        stages(tmp_path)[1].build_model().load_state_dict(state)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "seed: made with 0, wanted 1"),
        ({"batches": replace(CONFIG.batches, samples_per_scene=3)}, "samples_per_scene: made"),
        ({"batches": replace(CONFIG.batches, photometric=False)}, "photometric: made with True"),
        (
            {"batches": replace(CONFIG.batches, sensor=SensorConfig(strength=1.0))},
            "batches.sensor: made with None, wanted",
        ),
        ({"batches": replace(CONFIG.batches, views=(2, 8))}, r"views: made with \[2, 3\], wanted"),
        ({"batches": replace(CONFIG.batches, samples_per_scene=None)}, "set batches.samples_per"),
        ({"stage": replace(STAGE, backbone=NanoConfig(width=128))}, "stage.backbone.width: made"),
        ({"validation_views": (8,)}, r"validation_views: made with \[2\], wanted \[8\]"),
    ],
)
def test_other_settings_are_refused_with_both_values(cache: Path, change: dict, message: str):
    with pytest.raises(ValueError, match=message):
        check_cache(FeatureCache(cache), replace(CONFIG, **change), ROOMS)


def test_settings_that_need_less_are_taken(cache: Path):
    # A sensor of no strength, whatever its other settings, changes no photo.
    off = SensorConfig(blur_px=9.0)
    fewer = replace(CONFIG.batches, views=(3,), batch_size=7, sensor=off)
    check_cache(FeatureCache(cache), replace(CONFIG, batches=fewer), ROOMS)
    assert STAGE.frozen_backbone().inputs == ("photos", "intrinsics")
    assert replace(STAGE, given_probability=1.0).frozen_backbone().inputs == ("intrinsics",)
    alone = replace(STAGE, given_probability=0.0, intrinsics_probability=0.0)
    assert alone.frozen_backbone().inputs == ("photos",)


def test_other_data_are_refused(cache: Path):
    features = FeatureCache(cache)
    with pytest.raises(KeyError, match="lacks 1 of 4 training scenes, the first is 4"):
        check_cache(features, CONFIG, FakeRooms(5, size=32))
    with pytest.raises(ValueError, match="its first frame differs"):
        check_cache(features, CONFIG, FakeRooms(4, size=40))
    other = validation_samples(FakeRooms(4, size=40), [0], 2)[0]
    with pytest.raises(ValueError, match=r"images of \(40, 40\) pixels, .* from \(32, 32\)"):
        features.geometry(other, given=False, intrinsics=False)
    with pytest.raises(KeyError, match="no features of sample 0/4/0 from photos"):
        features.geometry(replace(other, keys=("0/4/0",)), given=False, intrinsics=False)
    with pytest.raises(ValueError, match=r"set batches\.samples_per_scene"):
        features.geometry(replace(other, keys=()), given=False, intrinsics=False)


def test_only_settings_with_a_frozen_backbone_and_fixed_samples_are_cached(tmp_path: Path):
    learning = replace(CONFIG, stage=replace(STAGE, freeze_backbone=False))
    with pytest.raises(ValueError, match="frozen backbone"):
        fill_cache(learning, ROOMS, tmp_path, backbone_weights())
    anew = replace(CONFIG, batches=BatchConfig())
    with pytest.raises(ValueError, match=r"set batches\.samples_per_scene"):
        fill_cache(anew, ROOMS, tmp_path, backbone_weights())
    with pytest.raises(FileNotFoundError, match="instok3d train cache"):
        FeatureCache(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_cache_grows_and_replaces_a_damaged_file(quick_cache: Path, tmp_path: Path):
    fill_cache(QUICK, FEW, tmp_path, backbone_weights())
    torn = scene_path(tmp_path, "1")
    torn.write_bytes(torn.read_bytes()[:1000])
    with pytest.warns(UserWarning, match="is damaged"):
        filled = fill_cache(QUICK, ROOMS, tmp_path, backbone_weights())
    assert (filled.scenes, filled.made) == (4, 3)
    check_cache(FeatureCache(tmp_path), QUICK, ROOMS)
    assert torn.read_bytes() == scene_path(quick_cache, "1").read_bytes()
    with pytest.raises(ValueError, match=r"begun with other settings .*seed: made with 0"):
        fill_cache(replace(QUICK, seed=3), ROOMS, tmp_path, backbone_weights())


def test_two_runs_do_not_fill_one_cache(tmp_path: Path):
    with (
        alone_in(tmp_path / ".lock", "wait"),
        pytest.raises(ValueError, match="another run is writing features to"),
    ):
        fill_cache(CONFIG, FEW, tmp_path, backbone_weights())


class OneShortRoom(FakeRooms):
    """Room 2 has too few frames for three views."""

    def num_frames(self, number: int) -> int:
        return 3 if number == 2 else super().num_frames(number)


def test_a_scene_too_short_for_training_has_no_samples(tmp_path: Path):
    rooms = OneShortRoom(3, size=32)
    config = replace(QUICK, batches=replace(ONE_SAMPLE, views=(3,)))
    with pytest.warns(UserWarning, match="1 of 2 scenes are left out"):
        filled = fill_cache(config, rooms, tmp_path, backbone_weights())
    assert (filled.scenes, filled.samples) == (3, 2)
    check_cache(FeatureCache(tmp_path), config, rooms)


def test_killed_while_writing_it_goes_on_to_the_same_bytes(quick_cache: Path, tmp_path: Path):
    program = """
        import os, signal
        from pathlib import Path
        import torch
        from test_features import QUICK, ROOMS, backbone_weights, fill_cache
        from instok3d import files

        def kill_in_the_second_scene(handle):
            if list(Path({folder!r}, "scenes").glob("[0-9]*")):
                os.kill(os.getpid(), signal.SIGKILL)

        files.os.fsync = kill_in_the_second_scene
        torch.set_num_threads({threads})  # no BLAS promises the same bits on another number
        fill_cache(QUICK, ROOMS, Path({folder!r}), backbone_weights())
    """
    program = program.format(folder=str(tmp_path), threads=torch.get_num_threads())
    ended = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
        check=False,
    )
    assert ended.returncode == -signal.SIGKILL
    left = {path.name.startswith(".") for path in (tmp_path / "scenes").iterdir()}
    assert left == {True, False}
    filled = fill_cache(QUICK, ROOMS, tmp_path, backbone_weights())
    assert filled.made == 3
    names = sorted(path.name for path in (tmp_path / "scenes").iterdir())
    assert names == sorted(path.name for path in (quick_cache / "scenes").iterdir())
    for name in names:
        assert (tmp_path / "scenes" / name).read_bytes() == (
            quick_cache / "scenes" / name
        ).read_bytes()


@pytest.mark.usefixtures("plane")
def test_killed_at_any_operation_a_cache_is_gone_on_with_or_begun_anew(tmp_path: Path):
    """Another backbone may begin it anew as long as no index says whose features it holds."""
    small = replace(
        CONFIG,
        stage=replace(STAGE, backbone=PlaneConfig()),
        batches=replace(CONFIG.batches, views=(2,), samples_per_scene=1),
        validation_views=(2,),
    )
    torch.manual_seed(0)
    weights, others = (PlaneBackbone(PlaneConfig()).state_dict() for _ in range(2))
    threads = torch.get_num_threads()

    def prepare() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        (tmp_path / "work").mkdir()
        return tmp_path / "work"

    def fill(work: Path, own: dict[str, torch.Tensor] = weights) -> None:
        fill_cache(small, FEW, work / "cache", own)

    seen = set()
    torch.set_num_threads(1)  # it is forked
    try:
        for work in every_kill(prepare, fill, step=5):
            begun = (work / "cache" / "features.json").exists()
            cache = FeatureCache(work / "cache") if begun else None
            made = [name for name in "01" if cache is not None and cache.has_scene(name)]
            for name in made:
                assert cache is not None
                assert "settings" in cache.scene_metadata(name)
            seen.add((begun, len(made)))
            fill(work, weights if begun else others)
            FeatureCache(work / "cache").backbone_weights()
            found = sorted(str(path.relative_to(work)) for path in work.rglob("*"))
            assert found == [
                "cache", "cache/backbone.safetensors", "cache/features.json", "cache/scenes",
                "cache/scenes/0.safetensors", "cache/scenes/1.safetensors",
            ]  # fmt: skip
    finally:
        torch.set_num_threads(threads)
    assert seen == {(False, 0), (True, 0), (True, 1), (True, 2)}


def test_a_backbone_with_pointmaps_of_its_own_keeps_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    forward = NanoBackbone.forward

    def with_point_head(self: NanoBackbone, views):
        geometry = forward(self, views)
        return replace(geometry, pointmaps=geometry.pointmaps * 1.5 + 0.25)

    monkeypatch.setattr(NanoBackbone, "forward", with_point_head)
    stage = replace(STAGE, given_probability=0.0, intrinsics_probability=0.0)
    config = replace(QUICK, stage=stage)
    fill_cache(config, FEW, tmp_path, backbone_weights())
    sample = SceneBatches(FEW, [1], ONE_SAMPLE, seed=QUICK.seed).fixed_sample(1, 2, 0)
    backbone = NanoBackbone(BACKBONE)
    backbone.load_state_dict(backbone_weights())
    with torch.no_grad():
        expected = backbone(replace(sample.context, intrinsics=None, cam_from_world=None,
                                    depths=None))  # fmt: skip
    found = FeatureCache(tmp_path).geometry(sample, given=False, intrinsics=False)
    torch.testing.assert_close(found.pointmaps, expected.pointmaps, rtol=1e-3, atol=1e-3)
    with pytest.raises(ValueError, match="pointmaps of NanoBackbone depend on given cameras"):
        fill_cache(QUICK, FEW, tmp_path / "given", backbone_weights())


def test_values_too_large_for_float16_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    forward = NanoBackbone.forward

    def with_large_features(self: NanoBackbone, views):
        geometry = forward(self, views)
        return replace(geometry, features=geometry.features * 1e6)

    monkeypatch.setattr(NanoBackbone, "forward", with_large_features)
    with pytest.raises(ValueError, match="features may be cached as bfloat16"):
        fill_cache(QUICK, FEW, tmp_path, backbone_weights())
    filled = fill_cache(QUICK, FEW, tmp_path / "wide", backbone_weights(), dtype="bfloat16")
    assert filled.made == 2


def test_an_index_of_another_version_is_refused(tmp_path: Path):
    (tmp_path / "features.json").write_text(json.dumps({"format": "instok3d-features-0"}))
    with pytest.raises(ValueError, match="no index of cached features of this version"):
        FeatureCache(tmp_path)
    (tmp_path / "features.json").write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        FeatureCache(tmp_path)
