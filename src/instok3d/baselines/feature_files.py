"""Files of models that give each Gaussian a feature: safetensors with the sizes and the card."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from safetensors import safe_open
from torch import nn

from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.registry import backbone_names, build_backbone, kind_named, name_of
from instok3d.baselines.feature_scene import FeatureModel
from instok3d.baselines.pixel_features import PixelFeatureConfig, PixelFeatures
from instok3d.baselines.query_gaussians import QueryGaussianConfig, QueryGaussians
from instok3d.errors import MissingWeightsError
from instok3d.files import write_safetensors
from instok3d.model.file_checks import check_finite, check_tensors, config_of_json
from instok3d.reading import naming_damage, one_of, parse_json

FORMAT = "instok3d-features-1"
REMEDY = "export it again: instok3d train export"

FeatureMethodName = Literal["uni3r-style", "c3g-style"]
MODELS: dict[FeatureMethodName, tuple[type, type]] = {
    "uni3r-style": (PixelFeatureConfig, PixelFeatures),
    "c3g-style": (QueryGaussianConfig, QueryGaussians),
}
"""Sizes and network of each."""


def name_of_model(model: FeatureModel) -> FeatureMethodName:
    """Of which method a model is."""
    return next(name for name, (_, kind) in MODELS.items() if isinstance(model, kind))


def save_feature_model(
    model: FeatureModel, path: Path, *, card: Mapping[str, Any], half: bool = True
) -> None:
    """Write a model with its backbone as one safetensors file; the folder must be there.

    Args:
        model: Its backbone must be registered.
        path: Name of the file.
        card: How and on what it was trained: JSON.
        half: Store float16.

    Raises:
        ValueError: A weight is not finite (in float16, where that is asked for).
    """
    assert isinstance(model, nn.Module)
    state = {
        name: value.half() if half and value.is_floating_point() else value
        for name, value in model.state_dict().items()
    }
    check_finite(state, half=half)
    metadata = {
        "format": FORMAT,
        "method": name_of_model(model),
        "config": json.dumps(asdict(model.config), allow_nan=False),
        "backbone": name_of(model.backbone),
        "backbone_config": json.dumps(asdict(model.backbone.config), allow_nan=False),
        "card": json.dumps(dict(card), allow_nan=False),
    }
    write_safetensors(path, state, metadata)


def load_feature_model(path: Path, method: FeatureMethodName | None = None) -> FeatureModel:
    """The model of a file in float32, in eval mode on the CPU.

    Args:
        path: The file.
        method: Of which it must be; None takes any.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged, or holds something else.
    """
    if not path.is_file():
        raise MissingWeightsError(
            f"no model {path}; train one (instok3d train nano-{method or 'uni3r-style'}) and "
            "export it"
        )
    with naming_damage(path, REMEDY), safe_open(path, framework="pt") as stream:
        metadata = stream.metadata() or {}
        one_of(metadata.get("format"), (FORMAT,))
        found = one_of(metadata["method"], tuple(MODELS))
        if method is not None and found != method:
            raise ValueError(f"{path} holds a model of {found}, wanted is one of {method}")
        config = config_of_json(MODELS[found][0], parse_json(metadata["config"], "", REMEDY), {})
        backbone = _backbone_config(metadata)

        def build() -> PixelFeatures | QueryGaussians:
            return new_model(config, build_backbone(backbone))

        slices = {name: stream.get_slice(name) for name in stream.keys()}  # noqa: SIM118
        header = {name: (tuple(s.get_shape()), s.get_dtype()) for name, s in slices.items()}
        check_tensors(build, header)
        state = {name: stream.get_tensor(name) for name in header}
        check_finite(state)
        model = build()
        model.load_state_dict(state)
    return model.eval()


def _backbone_config(metadata: Mapping[str, str]) -> Any:
    kind = kind_named(one_of(metadata["backbone"], tuple(backbone_names())))
    values = parse_json(metadata["backbone_config"], "", REMEDY)
    return config_of_json(kind.config, values, {kind.config.__name__: dict(kind.added_later)})


def new_model(
    config: PixelFeatureConfig | QueryGaussianConfig, backbone: GeometryBackbone
) -> PixelFeatures | QueryGaussians:
    """A model of these sizes with random weights."""
    if isinstance(config, PixelFeatureConfig):
        return PixelFeatures(backbone, config)
    return QueryGaussians(backbone, config)
