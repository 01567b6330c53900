"""Models on disk: one safetensors file with the weights, the sizes and the card."""

import json
import math
import reprlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

from safetensors import SafetensorError, safe_open

from instok3d.backbones.cost import Outline
from instok3d.backbones.registry import backbone_names, build_backbone, kind_named, name_of
from instok3d.data.batches import Unit
from instok3d.errors import MissingWeightsError
from instok3d.files import write_safetensors
from instok3d.model.file_checks import Header, check_finite, check_tensors, config_of_json
from instok3d.model.on_paper import StandIn, without_random_fills
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.reading import UNREADABLE, naming_damage, parse_json, reason_of

FORMAT = "instok3d-model-1"
REMEDY = "fetch or export it again"
"""What to do about a damaged file."""
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
    state = {
        name: value.half() if half and value.is_floating_point() else value
        for name, value in model.state_dict().items()
    }
    check_finite(state, half=half)
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
    sizes, config = read_sizes(path)  # before memory for them is taken
    with naming_damage(path, REMEDY):
        with safe_open(path, framework="pt") as stream:
            # Still in the type of the file: the model has float32 of its own, and copies each.
            state = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118
        check_finite(state)
        with without_random_fills():
            model = Tokenizer(build_backbone(sizes), config)
        model.load_state_dict(state)  # every weight: strict
    return model.eval()


def read_sizes(path: Path | str | None = None) -> tuple[Any, TokenizerConfig]:
    """Sizes of the backbone and of the tokenizer in a file, without loading it; for `memory`.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or is not a model of this version.
    """
    path = _existing(path)
    metadata, header = _read_header(path)
    with naming_damage(path, REMEDY):
        return _sizes(metadata, header)


def read_card(path: Path | str | None = None) -> dict[str, Any]:
    """What the file says of its model; the shipped one's for None.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or is not a model of this version.
    """
    path = _existing(path)
    with naming_damage(path, REMEDY):
        card = parse_json(_read_header(path)[0]["card"], f"{path}, its card", REMEDY)
        if not isinstance(card, dict):
            raise ValueError("its card is no JSON object")
        return card


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


def _read_header(path: Path) -> tuple[dict[str, str], Header]:
    """What a file says of itself and of its tensors."""
    try:
        with safe_open(path, framework="pt") as stream:
            metadata = stream.metadata() or {}
            slices = {name: stream.get_slice(name) for name in stream.keys()}  # noqa: SIM118
            header = {name: (tuple(s.get_shape()), s.get_dtype()) for name, s in slices.items()}
    except SafetensorError as error:
        raise ValueError(f"{path} is not a whole safetensors file: {reason_of(error)}") from error
    if metadata.get("format") != FORMAT:
        raise ValueError(
            f"{path} is not an InsTok3D model: its format is "
            f"{reprlib.repr(metadata.get('format'))}, wanted {FORMAT!r}"
        )
    return metadata, header


def _sizes(metadata: Mapping[str, str], header: Header) -> tuple[Any, TokenizerConfig]:
    name = metadata["backbone"]
    if name not in (names := backbone_names()):
        raise ValueError(
            f"it needs the backbone {reprlib.repr(name)}; there are {', '.join(names)}: install "
            "the package that brings it (docs/backbones.md)"
        )
    kind = kind_named(name)
    added_later = {**ADDED_LATER, kind.config.__name__: dict(kind.added_later)}
    backbone, tokenizer = (
        config_of_json(each, parse_json(metadata[key], "", REMEDY), added_later)
        for each, key in (
            (kind.config, "backbone_config"),
            (TokenizerConfig, "tokenizer_config"),
        )
    )
    try:
        if kind.outline is None:  # it can be built without memory
            check_tensors(lambda: Tokenizer(build_backbone(backbone), tokenizer), header)
        else:
            _check_outlined(kind.outline(backbone), tokenizer, header)
    except UNREADABLE as error:
        raise ValueError(f"its weights do not fit its own sizes: {reason_of(error)}") from error
    return backbone, tokenizer


def _check_outlined(outline: Outline, tokenizer: TokenizerConfig, header: Header) -> None:
    """As `check_tensors`, with no more known of the backbone than its number of parameters."""
    own, others = {}, {}
    for name, tensor in header.items():
        (own if name.startswith("backbone.") else others)[name] = tensor
    check_tensors(lambda: Tokenizer(StandIn(outline), tokenizer), others)
    found = sum(math.prod(shape) for shape, _ in own.values())
    if found < outline.numbers:
        raise ValueError(f"its backbone has {found} numbers, wanted {outline.numbers}")
