"""What cached features depend on, and whether those of a folder are the ones that a run needs."""

import hashlib
import json
from typing import Any

from instok3d.backbones.base import GeometryBackbone
from instok3d.data.scenes import SceneSource
from instok3d.training.cache.checks import INDEX
from instok3d.training.cache.features import FeatureCache, scene_path, weights_sha256
from instok3d.training.config import TrainConfig, to_json
from instok3d.training.held_out import split_scenes
from instok3d.training.stages.answers import FrozenBackbone

SCENES_CHECKED = 8
"""So many scenes are compared with the data when a run begins."""


def cached_backbone(config: TrainConfig) -> FrozenBackbone:
    """The backbone of a run whose features can be cached.

    Raises:
        ValueError: It learns, the stage has none, or the run draws new frames every time.
    """
    backbone = config.stage.frozen_backbone()
    if backbone is None:
        raise ValueError(
            "only a stage with a frozen backbone has features to cache, and the backbone of this "
            f"{config.stage.name} run is not frozen"
        )
    if config.batches.samples_per_scene is None:
        raise ValueError(
            "features are cached of fixed samples: set batches.samples_per_scene, for example to 4"
        )
    return backbone


def cache_settings(config: TrainConfig, backbone: GeometryBackbone, dtype: str) -> dict[str, Any]:
    """Everything that the stored answers follow from, but the scenes; JSON values."""
    frozen = cached_backbone(config)
    return {
        "backbone": to_json(frozen.config),
        "backbone_sha256": weights_sha256(backbone.state_dict()),
        "patch_size": backbone.patch_size,
        "feature_channels": backbone.feature_channels,
        "inputs": list(frozen.inputs),
        "dtype": dtype,
        "amp": config.amp,
        "seed": config.seed,
        "batches": _batch_settings(config),
        "validation_views": sorted(set(config.validation_views)),
    }


def settings_sha256(settings: dict[str, Any]) -> str:
    """Hash of the settings, in hexadecimal."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def scene_sha256(source: SceneSource, number: int) -> str:
    """What tells a scene from another of its name: number of frames, and the first one."""
    scene = source.frames(number, [0])
    digest = hashlib.sha256(f"{source.num_frames(number)} {tuple(scene.images.shape)}".encode())
    for value in (scene.images, scene.intrinsics.float(), scene.world_from_cam.float()):
        digest.update(value.contiguous().numpy().tobytes())
    return digest.hexdigest()


def check_cache(cache: FeatureCache, config: TrainConfig, source: SceneSource) -> None:
    """Fail before training unless the cache has what a run will ask for.

    Settings and names are compared of all scenes, pictures of a few.

    Raises:
        ValueError: It was made with other settings, or from another data set.
        KeyError: Scenes of the run are missing from it.
    """
    if phrases := _unfit_settings(cache.settings, config):
        raise ValueError(
            f"the features in {cache.folder} are not those of this run ({'; '.join(phrases)}); use "
            "the settings that they were made with, or make others with `instok3d train cache`"
        )
    names = [source.name_of(number) for number in range(len(source))]
    held_out, training = split_scenes(source, names, config.holdout)
    for role, known, numbers in (
        ("held-out", cache.held_out, held_out),
        ("training", cache.training, training),
    ):
        wanted, in_cache = [names[number] for number in numbers], set(known)
        lacking = [n for n in wanted if n not in in_cache or not cache.has_scene(n)]
        if lacking:
            raise KeyError(
                f"{cache.folder} lacks {len(lacking)} of {len(wanted)} {role} scenes, the first is "
                f"{lacking[0]}; run `instok3d train cache` with the settings of this run to add "
                "them"
            )
    every = held_out + training
    for number in every[:: -(-len(every) // SCENES_CHECKED)]:
        found = cache.scene_metadata(names[number])
        if found.get("settings") != settings_sha256(cache.settings):
            raise ValueError(
                f"{scene_path(cache.folder, names[number])} was made with other settings than "
                f"{INDEX} says; delete it and run `instok3d train cache` again"
            )
        if found.get("scene_sha256") != scene_sha256(source, number):
            raise ValueError(
                f"scene {names[number]} of the data is not the one that {cache.folder} was made "
                "from: its first frame differs; make the features anew into another folder"
            )


def differences(found: Any, wanted: Any, where: str = "") -> list[str]:
    """Where two JSON values differ, one phrase each: `name: made with 1, wanted 2`."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        names = sorted(found.keys() | wanted.keys())
        below = [differences(found.get(n), wanted.get(n), f"{where}.{n}".strip(".")) for n in names]
        return [phrase for part in below for phrase in part]
    return [] if found == wanted else [f"{where}: made with {found}, wanted {wanted}"]


def _unfit_settings(found: dict[str, Any], config: TrainConfig) -> list[str]:
    """What of a cache does not serve a run; it may hold more views and inputs than are needed."""
    frozen = cached_backbone(config)
    batches, wanted = dict(found["batches"]), _batch_settings(config)
    parts = {
        "batches.views": (batches.pop("views"), wanted.pop("views")),
        "validation_views": (found["validation_views"], config.validation_views),
        "inputs": (found["inputs"], frozen.inputs),
    }
    phrases = [
        f"{name}: made with {list(held)}, wanted {list(needed)}"
        for name, (held, needed) in parts.items()
        if not set(needed) <= set(held)
    ]
    return [
        *phrases,
        *differences(found["backbone"], to_json(frozen.config), "stage.backbone"),
        *differences(found["seed"], config.seed, "seed"),
        *differences(batches, wanted, "batches"),
    ]


def _batch_settings(config: TrainConfig) -> dict[str, Any]:
    """The settings that choose frames and pictures of a fixed sample."""
    values = to_json(config.batches)
    values["views"] = sorted(set(values["views"]))
    if not config.batches.sensor.strength:
        del values["sensor"]  # caches from before there was one serve as well
    return {name: value for name, value in values.items() if name not in ("type", "batch_size")}
