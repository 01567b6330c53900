"""Semantics of a model on disk: what lifts 2D features into its scenes, and the encoder itself."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from safetensors import safe_open
from torch import Tensor

from instok3d.files import write_safetensors
from instok3d.model.file_checks import config_of_json
from instok3d.model.tokenizer import Tokenizer
from instok3d.reading import naming_damage, parse_json, text
from instok3d.semantics.eight_bits import narrowed, widened
from instok3d.semantics.model import SemanticModel
from instok3d.semantics.tokens import SemanticTokensConfig

FORMAT = "instok3d-semantics-1"
PREFIX = "semantic."
"""Of tensors and metadata, so that the encoder may lie in the same file."""
ADDED_LATER = {"SemanticTokensConfig": {"levels": "group and anchor"}}
"""Sizes that files of before lack, and what they were made with."""
REMEDY = "train it again, or take the one that comes with instok3d"


@dataclass(frozen=True)
class LoadedSemantics:
    """What lifts the features of one encoder into scenes of one tokenizer."""

    model: SemanticModel
    encoder: str
    """Name of the encoder, by which scenes know its features."""
    card: Mapping[str, Any]
    """What the file says of how it was made."""


def save_semantics(
    model: SemanticModel,
    path: Path,
    *,
    encoder: str,
    tokenizer_sha256: str,
    card: Mapping[str, Any],
    half: bool = True,
    beside: tuple[Mapping[str, Tensor], Mapping[str, str]] = ({}, {}),
) -> None:
    """Write semantics as one safetensors file, atomically; the folder must be there.

    Args:
        model: What was trained.
        path: Name of the file.
        encoder: Name of the encoder whose features it lifts.
        tokenizer_sha256: Of the tokenizer it belongs to, see `tokenizer_digest`.
        card: How it was trained, on what, under which licence: JSON values.
        half: Store matrices in 8 bits and the rest in 16.
        beside: More tensors and metadata, such as the encoder's (`teachers.file.teacher_tensors`).

    Raises:
        ValueError: A weight is not finite in float16, where that is asked for.
    """
    weights = model.state_dict()
    stored = narrowed(weights) if half else {k: v.float() for k, v in weights.items()}
    state = dict(beside[0]) | {PREFIX + name: value for name, value in stored.items()}
    metadata = {
        "format": FORMAT,
        "encoder": encoder,
        "tokenizer": tokenizer_sha256,
        "config": json.dumps(asdict(model.decoder.config)),
        "card": json.dumps(dict(card), allow_nan=False),
    }
    named = {PREFIX + name: value for name, value in metadata.items()}
    write_safetensors(path, state, {**beside[1], **named})


def load_semantics(path: Path, tokenizer: Tokenizer) -> LoadedSemantics:
    """The semantics of a file, float32, in eval mode on the CPU.

    Args:
        path: The file.
        tokenizer: The one that the scenes will be made with.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds no semantics, is damaged, or belongs to another tokenizer.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there are no semantics {path}")
    with naming_damage(path, REMEDY), safe_open(path, "pt") as file:
        metadata = file.metadata() or {}
        names = [name for name in file.keys() if name.startswith(PREFIX)]  # noqa: SIM118
        stored = {name.removeprefix(PREFIX): file.get_tensor(name) for name in names}
    found = {k.removeprefix(PREFIX): v for k, v in metadata.items() if k.startswith(PREFIX)}
    if found.get("format") != FORMAT:
        raise ValueError(f"{path} holds no semantics of format {FORMAT!r}; {REMEDY}")
    if found.get("tokenizer") != tokenizer_digest(tokenizer):
        raise ValueError(f"{path} belongs to another model than the one it is to serve; {REMEDY}")
    with naming_damage(path, REMEDY):
        sizes = config_of_json(
            SemanticTokensConfig, parse_json(found["config"], "its sizes", ""), ADDED_LATER
        )
        model = SemanticModel(tokenizer, sizes)
        weights = widened(stored)
        try:
            model.load_state_dict(weights)
        except RuntimeError as error:
            raise ValueError("its weights are not those of its sizes") from error
        card = parse_json(found["card"], "its card", "")
        return LoadedSemantics(model.eval().requires_grad_(False), text(found["encoder"]), card)


def tokenizer_digest(tokenizer: Tokenizer) -> str:
    """SHA-256 of all weights as float16, the same for a model and the file it was exported to."""
    digest = hashlib.sha256()
    for name, value in sorted(tokenizer.state_dict().items()):
        digest.update(name.encode())
        whole = value.detach().cpu()
        numbers = whole.half() if whole.is_floating_point() else whole
        digest.update(numbers.contiguous().numpy().tobytes())
    return digest.hexdigest()
