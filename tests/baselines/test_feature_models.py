import json
from dataclasses import replace

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from easy_room import easy_sample
from instok3d.backbones import Prediction, settle_geometry
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.baselines.feature_files import (
    MODELS,
    load_feature_model,
    name_of_model,
    new_model,
    save_feature_model,
)
from instok3d.baselines.feature_method import FeatureMethod
from instok3d.baselines.feature_scene import FeatureScene, render_scene
from instok3d.baselines.pixel_features import PixelFeatureConfig
from instok3d.baselines.query_gaussians import QueryGaussianConfig
from instok3d.data.sample import Sample, photos_only
from instok3d.errors import MissingWeightsError
from instok3d.evaluation.methods import Method, Shown
from instok3d.model.pixel_gaussians import PixelGaussianConfig
from instok3d.types import Cameras, Geometry, Views

NANO = NanoConfig(width=64, layers=1)
CHANNELS = 5
SIZES = {
    "uni3r-style": PixelFeatureConfig(PixelGaussianConfig(8, 1, feature_channels=3), CHANNELS),
    "c3g-style": QueryGaussianConfig(300, 64, 1, encoder_channels=CHANNELS, initial_scale=0.08),
}


def made(name: str):
    torch.manual_seed(0)
    return new_model(SIZES[name], NanoBackbone(NANO)).eval()


@pytest.fixture(scope="module")
def sample() -> Sample:
    return easy_sample()


def true_geometry(sample: Sample) -> Geometry:
    """As a perfect backbone gives it, with colours as features of patches."""
    context = sample.context
    assert context.depths is not None
    assert context.cam_from_world is not None
    assert context.intrinsics is not None
    colors = torch.nn.functional.avg_pool2d(context.images[0], 8).flatten(2).mT[None]
    features = torch.cat([colors, torch.zeros(*colors.shape[:3], 125)], dim=-1)
    depths = context.depths
    return settle_geometry(context, Prediction(
        features, depths, torch.ones_like(depths), context.cam_from_world, context.intrinsics
    ))  # fmt: skip


def encoded_of(sample: Sample) -> torch.Tensor:
    """Features of an encoder that knows the true ids, four of them and a constant."""
    ids = sample.context_instances.clamp(0, 3)
    one_hot = torch.nn.functional.one_hot(ids, 4).movedim(-1, 2).float()
    return torch.cat([one_hot, torch.ones_like(one_hot[:, :, :1])], dim=2)


def target_cameras(sample: Sample) -> Cameras:
    views = sample.target
    assert views.cam_from_world is not None
    assert views.intrinsics is not None
    return Cameras(views.cam_from_world, views.intrinsics)


@pytest.mark.parametrize(
    ("name", "steps", "least_db"), [("uni3r-style", 30, 27), ("c3g-style", 70, 21)]
)
def test_an_easy_room_is_learned_with_its_features(name, steps, least_db, sample):
    """Working at all: the frame between the contexts, and whose feature each of its pixels has."""
    model, geometry, encoded = made(name), true_geometry(sample), encoded_of(sample)
    ids = sample.target_instances.clamp(0, 3)
    wanted = torch.nn.functional.one_hot(ids, 4).movedim(-1, 2).float()
    learning = [p for part, p in model.named_parameters() if not part.startswith("backbone.")]
    optimizer = torch.optim.Adam(learning, {"uni3r-style": 1e-2, "c3g-style": 3e-3}[name])
    quality, cosine = 0.0, 0.0
    for _ in range(steps):
        scene = model(photos_only(sample.context), encoded, geometry)
        seen = render_scene(scene, target_cameras(sample), 64, 64, detach=model.detaches_gaussians)
        features = torch.einsum("bvchw,fc->bvfhw", seen.features, scene.feature_map)[:, :, :4]
        error = (seen.colors - sample.target.images).square().mean()
        angle = torch.nn.functional.cosine_similarity(features, wanted, dim=2).mean()
        optimizer.zero_grad()
        (error + 0.2 * (1 - angle)).backward()
        optimizer.step()
        quality, cosine = float(-10 * error.detach().log10()), float(angle.detach())
    assert quality > least_db
    assert cosine > 0.8


def test_the_encoders_features_move_queries_only_in_their_own_stream(sample):
    model, geometry = made("c3g-style"), true_geometry(sample)
    scene = model(photos_only(sample.context), encoded_of(sample), geometry)
    bare = model(photos_only(sample.context), None, geometry)
    assert torch.equal(scene.gaussians.means, bare.gaussians.means)
    assert bare.features is None
    seen = render_scene(scene, target_cameras(sample), 64, 64, detach=True)
    assert seen.features is not None
    seen.features.sum().backward()
    moved = {name.split(".")[0] for name, p in model.named_parameters() if p.grad is not None}
    assert moved == {"source", "lifts", "lift_norm"}
    assert len(scene.gaussians.means[0]) == 300  # however many views there are


def test_every_pixel_has_a_gaussian_and_a_feature_and_features_may_move_it(sample):
    model = made("uni3r-style")
    scene = model(photos_only(sample.context), None, true_geometry(sample))
    assert scene.gaussians.means.shape == (1, 4 * 64 * 64, 3)
    assert scene.features is not None
    assert scene.features.shape == (1, 4 * 64 * 64, 3)
    assert torch.equal(scene.gaussians.anchor_index[0], torch.arange(4 * 64 * 64))
    seen = render_scene(scene, target_cameras(sample), 64, 64, detach=False)
    assert seen.features is not None
    opacity = torch.autograd.grad(seen.features.sum(), scene.gaussians.opacities)[0]
    assert opacity.abs().max() > 0


def test_queries_are_in_the_unit_of_the_points(sample):
    model, geometry = made("c3g-style"), true_geometry(sample)
    larger = replace(geometry, pointmaps=3 * geometry.pointmaps)
    views = photos_only(sample.context)
    first, second = (model(views, None, each).gaussians for each in (geometry, larger))
    torch.testing.assert_close(second.means, 3 * first.means)
    torch.testing.assert_close(second.scales, 3 * first.scales)
    unknown = geometry.pointmaps.clone()
    unknown[0, 0, 0, 0] = torch.nan
    third = model(views, None, replace(geometry, pointmaps=unknown)).gaussians
    assert third.means.isfinite().all()


def test_queries_stay_within_reach_of_their_starts(sample):
    model, geometry = made("c3g-style"), true_geometry(sample)
    with torch.no_grad():
        model.out.weight.mul_(1000)
    unit = geometry.pointmaps.norm(dim=-1).mean()
    scene = model(photos_only(sample.context), None, geometry)
    away = (scene.gaussians.means[0] / unit - model.starts).abs()
    assert away.max() <= model.config.reach * 1.0001
    assert away.max() > 0.9 * model.config.reach


def test_queries_attend_at_the_start_to_what_lies_near(sample):
    model, geometry = made("c3g-style"), true_geometry(sample)
    positions = model.fusion(photos_only(sample.context), geometry).positions[0]
    with torch.no_grad():
        alike = model._places(model.starts) @ model._places(positions).T
        query, key = model.layers[0].attention.query, model.layers[0].attention.key_value
        assert torch.equal(query.weight, key.weight[: len(query.weight)])
    distance = torch.cdist(model.starts.detach(), positions)
    near, far = distance < 0.5 * model.config.near, distance > 3 * model.config.near
    most = model._places(model.starts).detach().square().sum(dim=1).mean()
    assert near.any()
    assert alike[near].mean() > 0.6 * most
    assert alike[far].mean().abs() < 0.1 * most


@pytest.mark.parametrize(
    "wrong",
    [{"initial_opacity": 0.0}, {"initial_opacity": 1.0}, {"reach": 0.0}, {"near": -1.0},
     {"width": 63}],
)  # fmt: skip
def test_sizes_of_queries_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        QueryGaussianConfig(**wrong)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_is_a_method_that_knows_features_and_no_instances(name, sample):
    model = made(name)
    method = FeatureMethod(model, teacher=Encoder())
    assert isinstance(method, Method)
    assert not method.needs
    scene = method.fit(Shown(photos_only(sample.context)))
    seen = scene.at(scene.cameras, 64, 64)
    assert seen.masks is None
    assert seen.rendering.features is not None
    assert seen.rendering.features.shape == (4, CHANNELS, 64, 64)
    count = len(scene.gaussians.means)
    stored = {"uni3r-style": 3, "c3g-style": 64}[name] * count
    assert (scene.cost.gaussians, scene.cost.semantic_units) == (count, count)
    assert (scene.cost.label_scalars, scene.cost.feature_scalars) == (0, stored)
    assert scene.num_groups_used() is None
    with torch.no_grad():
        parts = dict(model.named_parameters())
        parts[{"uni3r-style": "head.out.bias", "c3g-style": "out.bias"}[name]].fill_(torch.nan)
    with pytest.raises(ValueError, match="not finite"):
        method.fit(Shown(photos_only(sample.context)))


def features_of(scene: FeatureScene) -> torch.Tensor:
    assert scene.features is not None
    return scene.features


class Encoder:
    """Colours as features."""

    name = "colours"
    channels = CHANNELS

    def features(self, images):
        return torch.cat([images, images[:, :2]], dim=1)

    def text(self, texts):
        raise ValueError("colours know no texts")

    def crop(self, image):
        raise ValueError("colours know no crops")


@pytest.mark.parametrize("name", MODELS)
def test_a_file_gives_the_same_model(name, tmp_path, sample):
    file = tmp_path / "model.safetensors"
    model = made(name)
    assert name_of_model(model) == name
    save_feature_model(model, file, card={"steps": 2}, half=False)
    again = load_feature_model(file, name)
    views, encoded = photos_only(sample.context), encoded_of(sample)
    assert torch.equal(features_of(again(views, encoded)), features_of(model(views, encoded)))
    with safe_open(file, framework="pt") as stream:
        metadata = stream.metadata()
    assert json.loads(metadata["card"]) == {"steps": 2}
    other = next(each for each in MODELS if each != name)
    with pytest.raises(ValueError, match=f"holds a model of {name}, wanted is one of {other}"):
        load_feature_model(file, other)
    weights = load_file(file)
    save_file({k: v for k, v in weights.items() if k != "expand.weight"}, file, metadata)
    with pytest.raises(ValueError, match=r"model\.safetensors is damaged .*expand\.weight"):
        load_feature_model(file)
    save_file(weights | {"expand.weight": weights["expand.weight"] * torch.nan}, file, metadata)
    with pytest.raises(ValueError, match=r"is damaged .*weight expand\.weight is not finite"):
        load_feature_model(file)
    model.expand.weight.data[0, 0] = torch.inf
    with pytest.raises(ValueError, match=r"weight expand\.weight is not finite in float16"):
        save_feature_model(model, tmp_path / "none.safetensors", card={})


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(MissingWeightsError, match=r"train one \(instok3d train nano-c3g-style\)"):
        load_feature_model(tmp_path / "none.safetensors", "c3g-style")


@pytest.mark.parametrize(
    ("config", "sizes", "told"),
    [
        (
            PixelFeatureConfig,
            {"head": PixelGaussianConfig()},
            "feature_channels must be at least 1",
        ),
        (PixelFeatureConfig, {"encoder_channels": 0}, "encoder_channels must be at least 1"),
        (QueryGaussianConfig, {"num_queries": 0}, "num_queries must be at least 1, got 0"),
        (QueryGaussianConfig, {"initial_scale": 0.9}, "at most scale_max=0.5, got 0.9"),
    ],
)
def test_sizes_that_make_no_model_are_refused(config, sizes, told):
    with pytest.raises(ValueError, match=told):
        config(**sizes)


def test_an_empty_batch_gives_empty_scenes(sample):
    none = Views(images=sample.context.images[:0])
    geometry = true_geometry(sample).map(lambda each: each[:0])
    for name in MODELS:
        scene: FeatureScene = made(name)(none, encoded_of(sample)[:0], geometry)
        assert len(scene.gaussians.means) == 0
