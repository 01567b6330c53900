"""Running a frozen backbone once over the fixed samples of a run, and keeping what it says."""

import errno
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from instok3d.backbones.base import GeometryBackbone, Prediction, settle_geometry
from instok3d.backbones.registry import build_backbone
from instok3d.data.batches import NoBaselineError, SceneBatches
from instok3d.data.sample import Sample, collate, photos_only
from instok3d.data.scenes import SceneSource
from instok3d.files import write_json, write_safetensors
from instok3d.locking import alone_in, remove_leftovers
from instok3d.reading import reason_of
from instok3d.training.cache.checks import FORMAT, INDEX, read_index
from instok3d.training.cache.features import (
    BACKBONE,
    SCENES,
    FeatureCache,
    scene_path,
    split_key,
)
from instok3d.training.cache.settings import (
    cache_settings,
    cached_backbone,
    differences,
    scene_sha256,
    settings_sha256,
)
from instok3d.training.config import TrainConfig
from instok3d.training.first_weights import load_backbone
from instok3d.training.held_out import split_scenes, validation_samples
from instok3d.types import Geometry, Views

FeatureType = Literal["float16", "bfloat16"]
LARGEST_HALF = torch.finfo(torch.float16).max
LOCK = ".lock"
"""Held by the run that writes features to a folder."""
SPARE_BYTES = 64 * 2**20
"""Disk space that is left free."""


@dataclass(frozen=True)
class FilledCache:
    """What a call of `fill_cache` has done."""

    scenes: int
    """In the cache, of this call and of those before it."""
    made: int
    """Scenes that were not there before."""
    samples: int
    """In those scenes."""
    bytes: int
    """Of all scene files together."""


@torch.no_grad()
def fill_cache(
    config: TrainConfig,
    source: SceneSource,
    folder: Path,
    weights: Mapping[str, Tensor],
    *,
    dtype: FeatureType = "float16",
    on_scene: Callable[[int, int], None] | None = None,
) -> FilledCache:
    """Write the backbone's geometry of every fixed sample that a run of `config` asks for.

    Each scene is one file that appears whole; scenes that are there are kept, so a stopped call is
    gone on with by the same call.

    Args:
        config: Of the run. Its batches must be of fixed samples.
        source: Scenes, of which the first config.holdout are for validation.
        folder: The cache; made if it is not there.
        weights: Of a backbone, or of a tokenizer with its backbone.
        dtype: Of the features. The maps are float16, the cameras float32.
        on_scene: Called with (scenes done, scenes in all) after each scene.

    Raises:
        ValueError: The settings have no fixed samples or are not those that the cache was begun
            with, the weights are not the backbone's, its answer to given cameras or depth cannot
            be rebuilt, a value does not fit the type, or another run is writing to the folder.
        OSError: The disk has too little space for all scenes.
    """
    sizes = cached_backbone(config).config
    torch.manual_seed(config.seed)  # what the weights lack begins the same in every call
    backbone = build_backbone(sizes)
    try:
        load_backbone(backbone, weights)
    except RuntimeError as error:
        raise ValueError(
            f"the weights do not fit the backbone of the run: {reason_of(error)}; give those of "
            "its sizes"
        ) from error
    backbone = backbone.to(config.device).eval()
    scene_path(folder, "").parent.mkdir(parents=True, exist_ok=True)
    refusal = f"another run is writing features to {folder}; wait for its end, or choose another"
    with alone_in(folder / LOCK, f"{refusal} folder"):
        for place in (folder, folder / SCENES):
            remove_leftovers(place)
        return _fill(config, source, folder, backbone, dtype, on_scene)


def _fill(
    config: TrainConfig,
    source: SceneSource,
    folder: Path,
    backbone: GeometryBackbone,
    dtype: FeatureType,
    on_scene: Callable[[int, int], None] | None,
) -> FilledCache:
    frozen = cached_backbone(config)
    names = [source.name_of(number) for number in range(len(source))]
    held_out, training = split_scenes(source, names, config.holdout)
    settings = cache_settings(config, backbone, dtype)
    _begin(folder, settings, backbone, [[names[k] for k in part] for part in (training, held_out)])
    cache, tag = FeatureCache(folder), settings_sha256(settings)
    batches = SceneBatches(source, training, config.batches, seed=config.seed)
    made = samples = 0
    checked = not frozen.given
    for done, number in enumerate(held_out + training):
        name, validation = names[number], done < len(held_out)
        metadata = {"settings": tag, "scene_sha256": scene_sha256(source, number)}
        if not _is_made(cache, name, metadata):
            tensors: dict[str, Tensor] = {}
            for sample in _scene_samples(source, batches, number, config, validation):
                moved = sample.to(config.device)
                if not checked:
                    _check_given(backbone, moved, config)
                    checked = True
                inputs = ("photos", "intrinsics") if validation else frozen.inputs
                for shown in inputs:
                    tensors |= _entries(backbone, moved, shown, config, getattr(torch, dtype))
                samples += len(sample.keys)
            _check_space(folder, tensors, len(names) - done)
            write_safetensors(scene_path(folder, name), tensors, metadata)
            made += 1
        if on_scene is not None:
            on_scene(done + 1, len(names))
    sizes = [scene_path(folder, name).stat().st_size for name in names]
    return FilledCache(len(names), made, samples, sum(sizes))


def _begin(
    folder: Path, settings: dict[str, Any], backbone: GeometryBackbone, scenes: list[list[str]]
) -> None:
    """Write index and backbone of a new cache; take up new scenes in one that is there."""
    is_new = not (folder / INDEX).exists()
    if not is_new:
        before = read_index(folder)
        if found := differences(before["settings"], settings):
            raise ValueError(
                f"{folder} was begun with other settings ({'; '.join(found)}); choose another "
                "folder or delete it"
            )
        known = (before["training"], before["held_out"])
        scenes = [list(dict.fromkeys(old + new)) for old, new in zip(known, scenes, strict=True)]
    # A run that was killed before it wrote the index may have left the weights of another backbone.
    if is_new or not _has_backbone(FeatureCache(folder)):
        write_safetensors(folder / BACKBONE, backbone.state_dict())
    training, held_out = scenes
    index = {"format": FORMAT, "settings": settings, "training": training, "held_out": held_out}
    write_json(folder / INDEX, index)


def _has_backbone(cache: FeatureCache) -> bool:
    """Whether the weights are there that the index names, which are those of this run."""
    if not (cache.folder / BACKBONE).exists():
        return False
    try:
        cache.backbone_weights()
    except ValueError as error:
        warnings.warn(f"{error}: it is written again", stacklevel=4)
        return False
    return True


def _is_made(cache: FeatureCache, name: str, wanted: Mapping[str, str]) -> bool:
    """Whether the scene's file is there and sound, of these settings and these pictures."""
    if not cache.has_scene(name):
        return False
    try:
        found = cache.scene_metadata(name)
        is_same = {key: found.get(key) for key in wanted} == wanted
        if is_same:
            cache.check_scene(name)
    except ValueError as error:
        warnings.warn(f"{error}: it is made anew", stacklevel=3)
        return False
    if not is_same:
        raise ValueError(
            f"{scene_path(cache.folder, name)} was made with other settings or from another scene "
            "of this name; choose another folder or delete it"
        )
    return True


def _scene_samples(
    source: SceneSource, batches: SceneBatches, number: int, config: TrainConfig, validation: bool
) -> Iterator[Sample]:
    """All samples of a scene that the run may ask for, in batches."""
    if validation:
        for views in sorted(set(config.validation_views)):
            yield from validation_samples(source, [number], views)
        return
    # A scene that is too short for training has a file without samples.
    count = (config.batches.samples_per_scene or 0) if number in batches.scenes else 0
    for views in sorted(set(config.batches.views)):
        size = max(1, config.batches.batch_size * 2 // views)
        singles = []
        for which in range(count):
            try:
                singles.append(batches.fixed_sample(number, views, which))
            except NoBaselineError as error:  # training takes another scene in its place
                warnings.warn(f"{error}; sample {which} is left out", stacklevel=3)
        for first in range(0, len(singles), size):
            yield collate(singles[first : first + size])


def _entries(
    backbone: GeometryBackbone, sample: Sample, shown: str, config: TrainConfig, dtype: torch.dtype
) -> dict[str, Tensor]:
    """The tensors of a batch for one kind of input, named views/number/input/what."""
    views = photos_only(sample.context, keep_intrinsics=shown == "intrinsics")
    geometry = _answer(backbone, views, config)
    from_depth = settle_geometry(views, _as_prediction(geometry)).pointmaps
    tensors = {}
    for scene, key in enumerate(sample.keys):
        entry = {
            "features": _fitting(geometry.features[scene], dtype),
            "depths": _fitting(geometry.depths[scene], torch.float16),
            "confidences": geometry.confidences[scene].clamp(max=LARGEST_HALF).half(),
            "cam_from_world": geometry.cameras.cam_from_world[scene].float(),
            "intrinsics": geometry.cameras.intrinsics[scene].float(),
        }
        points, rebuilt = geometry.pointmaps[scene].float(), from_depth[scene]
        if (points - rebuilt).abs().mean() > 1e-3 * rebuilt.abs().mean():
            entry["pointmaps"] = _fitting(points, torch.float16)
        tensors |= {f"{split_key(key)[1]}/{shown}/{name}": value for name, value in entry.items()}
    return tensors


def _answer(backbone: GeometryBackbone, views: Views, config: TrainConfig) -> Geometry:
    """The forward pass as a training step does it."""
    with torch.autocast(views.images.device.type, torch.bfloat16, enabled=config.amp):
        return backbone(views)


def _as_prediction(geometry: Geometry) -> Prediction:
    return Prediction(
        features=geometry.features,
        depths=geometry.depths,
        confidences=geometry.confidences,
        cam_from_world=geometry.cameras.cam_from_world,
        intrinsics=geometry.cameras.intrinsics,
    )


def _check_given(backbone: GeometryBackbone, sample: Sample, config: TrainConfig) -> None:
    """Fail where the network looks at given cameras and depth: its answer is not rebuilt then."""
    answer = _answer(backbone, photos_only(sample.context, keep_intrinsics=True), config)
    given = _answer(backbone, sample.context, config)
    rebuilt = settle_geometry(sample.context, _as_prediction(answer))
    for name in ("features", "pointmaps"):
        wanted, found = getattr(given, name).float(), getattr(rebuilt, name).float()
        if (wanted - found).abs().mean() > 1e-2 * wanted.abs().mean():
            raise ValueError(
                f"the {name} of {type(backbone).__name__} depend on given cameras or depth in a "
                "way that cannot be cached; set stage.given_probability to 0"
            )


def _fitting(value: Tensor, dtype: torch.dtype) -> Tensor:
    small = value.to(dtype)
    if not small.isfinite().all():
        raise ValueError(
            f"the backbone gave values up to {float(value.abs().max()):.3g}, not all of which are "
            f"finite in {dtype}; features may be cached as bfloat16 instead"
        )
    return small


def _check_space(folder: Path, tensors: Mapping[str, Tensor], scenes_left: int) -> None:
    """Fail early where scenes of this size do not all fit on the disk."""
    needed = scenes_left * sum(t.numel() * t.element_size() for t in tensors.values())
    free = shutil.disk_usage(folder).free
    if needed + SPARE_BYTES > free:
        raise OSError(
            errno.ENOSPC,
            f"{scenes_left} more scenes take {needed / 1e9:.1f} GB, free are {free / 1e9:.1f} GB",
            str(folder),
        )
