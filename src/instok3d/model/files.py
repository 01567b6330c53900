"""Models on disk: one safetensors file with the weights, the sizes and the card."""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

from safetensors import SafetensorError, safe_open
from torch import Tensor

from instok3d.backbones.registry import backbone_names, build_backbone, kind_named, name_of
from instok3d.data.batches import Unit
from instok3d.errors import MissingWeightsError
from instok3d.files import write_safetensors
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig

FORMAT = "instok3d-model-1"
DEFAULT_MODEL = Path(__file__).parents[1] / "assets" / "default_model.safetensors"

ADDED_LATER: dict[str, dict[str, Any]] = {
    "TokenizerConfig": {
        "normalize_scale": True,
        "pad_duplicates": False,
        "project_assignment": True,
        "window_views": 0,
        "thin_free_space": False,
    },
}
"""Sizes that files of this format may lack, and what such a file was made with."""


def save_model(model: Tokenizer, path: Path, *, card: Mapping[str, Any], half: bool = True) -> None:
    """Write a model as one safetensors file, atomically; the folder must be there.

    Args:
        model: Its backbone must be registered and have its sizes in `.config`.
        path: Name of the file.
        card: What to say of the model (how and on what it was trained, floors, licence): JSON.
        half: Store float16, half the size; values change by up to 1/2048 of themselves.

    Raises:
        ValueError: A weight is not finite (in float16, where that is asked for), or the
            backbone's class is not registered.
    """
    state: dict[str, Tensor] = {}
    for name, value in model.state_dict().items():
        if half and value.is_floating_point():
            value = value.half()
        if not value.isfinite().all():
            raise ValueError(f"weight {name} is not finite{' in float16' if half else ''}")
        state[name] = value
    kind = name_of(model.backbone)
    metadata = {
        "format": FORMAT,
        "backbone": kind,
        "backbone_config": json.dumps(asdict(model.backbone.config), allow_nan=False),
        "tokenizer_config": json.dumps(asdict(model.config), allow_nan=False),
        "card": json.dumps(dict(card), allow_nan=False),
    }
    write_safetensors(path, state, metadata)


def load_model(path: Path | str | None = None) -> Tokenizer:
    """The model of a file in float32, in eval mode on the CPU; the shipped one for None.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or is not a model of this version.
    """
    path = _existing(path)
    metadata, state = _read(path)
    sizes, config = _sizes(metadata, path)
    model = Tokenizer(build_backbone(sizes), config)
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(f"the weights in {path} do not fit its own sizes: {error}") from error
    return model.eval()


def read_sizes(path: Path | str | None = None) -> tuple[Any, TokenizerConfig]:
    """Sizes of the backbone and of the tokenizer in a file, without loading it; for `memory`.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or is not a model of this version.
    """
    path = _existing(path)
    return _sizes(_read_metadata(path), path)


def read_card(path: Path | str | None = None) -> dict[str, Any]:
    """What the file says of its model; the shipped one's for None.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or is not a model of this version.
    """
    path = _existing(path)
    return json.loads(_read_metadata(path)["card"])


def read_unit(path: Path | str | None = None) -> Unit | None:
    """The unit of length in which a file's model answers; None where it learned none.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or is not a model of this version, or its card names
            another unit than this version knows.
    """
    unit = read_card(path).get("unit")
    if unit not in (None, *get_args(Unit)):
        raise ValueError(
            f"the card of {path} says that its unit is {unit!r}; wanted one of "
            f"{', '.join(get_args(Unit))}, or none"
        )
    return unit


def _existing(path: Path | str | None) -> Path:
    if path is None and not DEFAULT_MODEL.is_file():
        raise MissingWeightsError(
            f"the default model is not installed (no {DEFAULT_MODEL}); give a model file, or "
            "install the package with its assets"
        )
    path = DEFAULT_MODEL if path is None else Path(path)
    if not path.is_file():
        raise MissingWeightsError(f"no model file {path}; give the path of a .safetensors model")
    return path


def _read_metadata(path: Path) -> dict[str, str]:
    try:
        with safe_open(path, framework="pt") as stream:
            metadata = stream.metadata() or {}
    except SafetensorError as error:
        raise ValueError(f"{path} is not a whole safetensors file: {error}") from error
    if metadata.get("format") != FORMAT:
        raise ValueError(
            f"{path} is not an InsTok3D model: its format is {metadata.get('format')!r}, "
            f"wanted {FORMAT!r}"
        )
    return metadata


def _read(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    metadata = _read_metadata(path)
    with safe_open(path, framework="pt") as stream:
        # Still in the type of the file: the model has float32 of its own, and copies each.
        return metadata, {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118


def _sizes(metadata: Mapping[str, str], path: Path) -> tuple[Any, TokenizerConfig]:
    kind = metadata["backbone"]
    if kind not in (names := backbone_names()):
        raise ValueError(
            f"{path} needs the backbone {kind!r}; there are {', '.join(names)}: install "
            "the package that brings it (docs/backbones.md)"
        )
    registered = kind_named(kind)
    values = {**registered.added_later, **json.loads(metadata["backbone_config"])}
    backbone = _config(registered.config, values, path)
    return backbone, _config(TokenizerConfig, json.loads(metadata["tokenizer_config"]), path)


def _config(config_class: type, values: Mapping[str, Any], path: Path) -> Any:
    """The dataclass of JSON values, nested ones too; keys and fields must be the same.

    A size that is missing must not become today's default: the file was made with another one,
    which ADDED_LATER knows where this version has more sizes than the one that wrote the file.
    """
    values = {**ADDED_LATER.get(config_class.__name__, {}), **values}
    known = {each.name for each in fields(config_class)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ValueError(
            f"{path} has sizes that this version does not know: "
            f"{', '.join(unknown)} of {config_class.__name__}"
        )
    missing = sorted(known - set(values))
    if missing:
        raise ValueError(
            f"{path} lacks sizes that this version needs: "
            f"{', '.join(missing)} of {config_class.__name__}; export it again"
        )
    types = get_type_hints(config_class)
    settled = {}
    for name, value in values.items():
        if is_dataclass(types[name]):
            value = _config(types[name], value, path)  # pyright: ignore[reportArgumentType]
        settled[name] = tuple(value) if isinstance(value, list) else value
    return config_class(**settled)
