"""Answers of a frozen backbone, read from disk in place of running it.

`training.cache.writing` makes the folder. Each scene has a file with the geometry of some fixed
samples of it, by the samples' keys, for the kinds of input that the run needs.
"""

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import torch
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor, nn

from instok3d.backbones.base import GeometryBackbone, Prediction, settle_geometry
from instok3d.data.sample import Sample, photos_only
from instok3d.reading import naming_damage
from instok3d.training.cache.checks import REPLACE, check_answer, read_index
from instok3d.types import Geometry, Views

BACKBONE = "backbone.safetensors"
SCENES = "scenes"

BackboneInput = Literal["photos", "intrinsics"]
"""What the network was shown: bare photos, or photos with their intrinsics. What it says when true
cameras and depth are given too is rebuilt from the second."""

OPEN_FILES = 64
"""Scenes whose file stays open."""


class FeatureCache:
    """The features of a folder that `instok3d train cache` has made.

    Args:
        folder: That folder.

    Raises:
        FileNotFoundError: There is none, or it holds no features.
        ValueError: It is of another version, or damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        index = read_index(folder)
        self.settings: dict[str, Any] = index["settings"]
        self.training: list[str] = index["training"]
        self.held_out: list[str] = index["held_out"]
        self._open = lru_cache(maxsize=OPEN_FILES)(self._open_scene)

    def backbone(self, config: Any) -> "CachedBackbone":
        """What stands in a model where its backbone would be; `config` is that of the backbone."""
        return CachedBackbone(self.settings, config)

    def backbone_weights(self) -> dict[str, Tensor]:
        """The weights that the features come from, float32.

        Raises:
            ValueError: The file is missing, damaged or of another backbone.
        """
        path = self.folder / BACKBONE
        if not path.is_file():
            raise ValueError(f"{path} is missing; run `instok3d train cache` again")
        with naming_damage(path, REPLACE):
            weights = load_file(path)
        self.check_backbone(weights, str(path))
        return weights

    def check_backbone(self, weights: Mapping[str, Tensor], where: str) -> None:
        """Fail unless these are the weights that the features come from.

        Raises:
            ValueError: They are not.
        """
        found, wanted = weights_sha256(weights), self.settings["backbone_sha256"]
        if found != wanted:
            raise ValueError(
                f"the backbone in {where} has the weights sha256:{found[:12]}, the features in "
                f"{self.folder} were made by sha256:{wanted[:12]}; leave the first weights out to "
                "train on those features, or make others with `instok3d train cache`"
            )

    def geometry(self, sample: Sample, *, given: bool, intrinsics: bool) -> Geometry:
        """What the backbone said of the sample's context views; its forward pass, up to rounding.

        Args:
            sample: Of a training batch or of validation.
            given: As if it had been shown true cameras and depth too.
            intrinsics: As if it had been shown the intrinsics.

        Raises:
            KeyError: The sample is not in the cache.
            ValueError: It has no key, or its images have another size than when it was cached.
        """
        if not sample.keys:
            raise ValueError(
                "cached features need samples that come again: set batches.samples_per_scene to "
                f"the {self.settings['batches']['samples_per_scene']} of the cache"
            )
        context, device = sample.context, sample.context.images.device
        shown: BackboneInput = "intrinsics" if given or intrinsics else "photos"
        entries = [self._entry(key, shown, context) for key in sample.keys]

        def joined(name: str) -> Tensor:
            # float32 first: autocast on a CPU does not know float16.
            return torch.stack([entry[name].float() for entry in entries]).to(device)

        prediction = Prediction(
            features=joined("features"),
            depths=joined("depths"),
            confidences=joined("confidences"),
            cam_from_world=joined("cam_from_world"),
            intrinsics=joined("intrinsics"),
        )
        views = context if given else photos_only(context, keep_intrinsics=intrinsics)
        geometry = settle_geometry(views, prediction)
        if not given:
            for scene, entry in enumerate(entries):
                if "pointmaps" in entry:
                    geometry.pointmaps[scene] = entry["pointmaps"].to(geometry.pointmaps)
        return geometry

    def has_scene(self, name: str) -> bool:
        """Whether the scene has a file, whole or not."""
        return scene_path(self.folder, name).is_file()

    def scene_metadata(self, name: str) -> dict[str, str]:
        """What the file of a scene says of itself: hashes of the settings and of the scene.

        Raises:
            KeyError: There is no such file.
            ValueError: It is damaged.
        """
        return self._open(name)[1]

    def check_scene(self, name: str) -> None:
        """Fail unless all the answers in the file of a scene can be some; reads the whole file.

        Raises:
            KeyError: There is no such file.
            ValueError: It is damaged.
        """
        path = scene_path(self.folder, name)
        for prefix in self._open(name)[2]:
            with naming_damage(path, REPLACE):
                views, number, _ = prefix.removesuffix("/").split("/")
                found = self._tensors(name, prefix)
                check_answer(
                    found, self.settings, int(views), f"{path}, sample {name}/{views}/{number},"
                )

    def _tensors(self, scene: str, prefix: str) -> dict[str, Tensor]:
        """What a file has of one sample and kind of input."""
        file, _, names = self._open(scene)
        with naming_damage(scene_path(self.folder, scene), REPLACE):
            return {n.removeprefix(prefix): file.get_tensor(n) for n in names.get(prefix, ())}

    def _entry(self, key: str, shown: BackboneInput, context: Views) -> dict[str, Tensor]:
        scene, rest = split_key(key)
        found = self._tensors(scene, f"{rest}/{shown}/")
        if not found:
            raise KeyError(
                f"{self.folder} has no features of sample {key} from {shown}; "
                "make them with `instok3d train cache` and the settings of this run"
            )
        file_name = scene_path(self.folder, scene)
        depths = found.get("depths", context.images)
        size, wanted = depths.shape[-2:], context.images.shape[-2:]
        if size != wanted:
            raise ValueError(
                f"sample {key} has images of {tuple(wanted)} pixels, its features in "
                f"{self.folder} were made from {tuple(size)}"
            )
        check_answer(found, self.settings, context.images.shape[1], f"{file_name}, sample {key},")
        return found

    def _open_scene(self, name: str) -> tuple[Any, dict[str, str], dict[str, list[str]]]:
        """The open file of a scene, what it says of itself, and its tensors by their prefix."""
        path = scene_path(self.folder, name)
        if not self.has_scene(name):
            raise KeyError(
                f"{self.folder} has no features of scene {name}: the cache is not finished, or "
                "the scene is new; run `instok3d train cache` with the same settings again"
            )
        with naming_damage(path, REPLACE):
            file = safe_open(path, framework="pt")
            names: dict[str, list[str]] = {}
            for each in file.keys():  # noqa: SIM118
                names.setdefault(each[: each.rfind("/") + 1], []).append(each)
            return file, dict(file.metadata() or {}), names


class CachedBackbone(GeometryBackbone):
    """Stands for a backbone whose answers are cached: its sizes and the hash of its weights.

    The hash travels in the checkpoints of the run, so that a run cannot go on with the features
    of another backbone.
    """

    def __init__(self, settings: Mapping[str, Any], config: Any) -> None:
        super().__init__()
        self.patch_size = settings["patch_size"]
        self.feature_channels = settings["feature_channels"]
        self.config = config
        sha256 = bytes.fromhex(settings["backbone_sha256"])
        self.weights_sha256: Tensor
        self.register_buffer("weights_sha256", torch.tensor(list(sha256), dtype=torch.uint8))
        self.register_load_state_dict_pre_hook(_refuse_another_backbone)

    def forward(self, views: Views) -> Geometry:
        """Always fails.

        Raises:
            ValueError: The backbone was not loaded.
        """
        raise ValueError("the backbone of this run is not loaded: its features come from a cache")


def _refuse_another_backbone(
    module: nn.Module, state: dict[str, Any], prefix: str, *unused: object
) -> None:
    assert isinstance(module, CachedBackbone)
    found = state.get(f"{prefix}weights_sha256")
    if found is not None and not torch.equal(found.cpu(), module.weights_sha256.cpu()):
        raise ValueError(
            "the run was begun with the features of another backbone "
            f"(sha256:{bytes(found.tolist()).hex()[:12]}) than those of its cache now "
            f"(sha256:{bytes(module.weights_sha256.tolist()).hex()[:12]})"
        )


def scene_path(folder: Path, name: str) -> Path:
    """The file with the features of a scene."""
    return folder / SCENES / f"{name}.safetensors"


def split_key(key: str) -> tuple[str, str]:
    """The scene of a sample's key, and views/number."""
    scene, views, number = key.rsplit("/", 2)
    return scene, f"{views}/{number}"


def weights_sha256(weights: Mapping[str, Tensor]) -> str:
    """Hash of the names, shapes and float32 values of weights, in hexadecimal."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        value = weights[name].detach().cpu()
        value = value.float() if value.is_floating_point() else value
        digest.update(f"{name} {tuple(value.shape)} {value.dtype}\n".encode())
        digest.update(value.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def of_backbone(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The backbone's weights among those of a tokenizer, or all where it is a backbone's file."""
    prefix = "backbone."
    inner = {k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)}
    return inner or dict(weights)


def with_backbone(cache: FeatureCache, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """All weights of a model that was trained on cached features, its backbone's too."""
    own = {k: v for k, v in weights.items() if not k.startswith("backbone.")}
    return own | {f"backbone.{k}": v for k, v in cache.backbone_weights().items()}
