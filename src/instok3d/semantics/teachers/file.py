"""The embedded teacher as tensors of a file: matrices in 8 bits, everything else in 16."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from torch import Tensor

from instok3d.files import replacing, write_safetensors
from instok3d.reading import naming_damage, one_line, one_of, parse_json, text, whole_number
from instok3d.semantics.eight_bits import narrowed, widened
from instok3d.semantics.predictor import Predictor, PredictorConfig
from instok3d.semantics.teachers.rooms import RoomTeacher
from instok3d.semantics.text import TextTable
from instok3d.semantics.wordpiece import UNKNOWN

FORMAT = "instok3d-teacher-1"
PREFIX = "teacher."
"""Of all its tensors, so that others may lie in the same file."""
RECORD = "teacher"
"""Of the metadata: what is no tensor, as JSON."""
REMEDY = "make it again or take the one that comes with instok3d"
PREDICTOR = "predictor."
SIZES = tuple(asdict(PredictorConfig()))
MAX_SIZE = 4096
"""Of a network; sizes beyond are taken for damage."""


def teacher_tensors(teacher: RoomTeacher) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors, by names with PREFIX, and metadata that a teacher is made of again."""
    tensors = {"table.rows": teacher.table.rows, "table.scales": teacher.table.scales}
    for name, value in narrowed(teacher.predictor.state_dict()).items():
        tensors[f"{PREDICTOR}{name}"] = value
    record = {
        "format": FORMAT,
        "name": teacher.name,
        "config": asdict(teacher.predictor.config),
        "vocabulary": teacher.table.vocabulary,
        "source": teacher.table.source,
        "credits": teacher.credits,
    }
    whole = {PREFIX + name: value.contiguous() for name, value in tensors.items()}
    return whole, {RECORD: json.dumps(record)}


def teacher_of(
    tensors: Mapping[str, Tensor], metadata: Mapping[str, str], where: Path
) -> RoomTeacher:
    """The teacher of such tensors and metadata; others beside them are left alone.

    Raises:
        ValueError: They are of no such teacher, or damaged.
    """
    if RECORD not in metadata:
        raise ValueError(f"{where} holds no teacher; {REMEDY}")
    own = {k.removeprefix(PREFIX): v for k, v in tensors.items() if k.startswith(PREFIX)}
    with naming_damage(where, REMEDY):
        record = parse_json(metadata[RECORD], "what it says of its teacher", "")
        one_of(record["format"], (FORMAT,))
        table = _table(own, record)
        sizes = {key: whole_number(record["config"][key], 1, MAX_SIZE) for key in SIZES}
        if sizes["channels"] != table.rows.shape[1]:
            raise ValueError("its predictor and its table of text are of two spaces")
        weights = _weights(own)
        _check_shapes(weights, PredictorConfig(**sizes))
        predictor = Predictor(PredictorConfig(**sizes))
        predictor.load_state_dict(weights)
        name = text(record["name"])
        credits = tuple(one_line(line) for line in record.get("credits", ()))
    return RoomTeacher(predictor, table, name, credits)


def save_teacher(teacher: RoomTeacher, path: Path, *, overwrite: bool = False) -> None:
    """Write a teacher alone as one safetensors file.

    Raises:
        FileExistsError: The file is there.
    """
    tensors, metadata = teacher_tensors(teacher)
    with replacing(path, overwrite=overwrite) as part:
        write_safetensors(part, tensors, metadata)


def load_teacher(path: Path, device: torch.device | str = "cpu") -> RoomTeacher:
    """Read the teacher of a file that `save_teacher` wrote, or that holds one among others.

    Args:
        path: The file.
        device: Where its predictor runs.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds no teacher, or is damaged.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no teacher {path}")
    with naming_damage(path, REMEDY), safe_open(path, "pt") as file:
        metadata = file.metadata() or {}
        names = [name for name in file.keys() if name.startswith(PREFIX)]  # noqa: SIM118
        tensors = {name: file.get_tensor(name) for name in names}
    teacher = teacher_of(tensors, metadata, path)
    teacher.predictor.to(device)
    return teacher


def holds_encoder(path: Path) -> bool:
    """Whether a file of semantics has the embedded teacher in it; others' weights stay outside.

    Raises:
        ValueError: The file is damaged.
    """
    with naming_damage(path, REMEDY), safe_open(path, "pt") as file:
        return RECORD in (file.metadata() or {})


def _table(own: Mapping[str, Tensor], record: Mapping[str, Any]) -> TextTable:
    rows, scales = own["table.rows"], own["table.scales"]
    vocabulary = tuple(text(piece) for piece in record["vocabulary"])
    if rows.dtype != torch.int8 or rows.ndim != 2 or scales.dtype != torch.float32:
        raise ValueError("its table of text has another kind of numbers")
    if not len(vocabulary) == len(rows) == len(scales) or UNKNOWN not in vocabulary:
        raise ValueError("words, rows and scales of its table do not fit together")
    if not scales.isfinite().all():
        raise ValueError("its table of text has scales that are not finite")
    return TextTable(vocabulary, rows, scales, text(record["source"]))


def _weights(own: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Of the predictor, float32."""
    return widened(
        {k.removeprefix(PREDICTOR): v for k, v in own.items() if k.startswith(PREDICTOR)}
    )


def _check_shapes(weights: Mapping[str, Tensor], config: PredictorConfig) -> None:
    """Before memory is taken for a network of sizes that the file only claims."""
    with torch.device("meta"):
        wanted = {name: tuple(v.shape) for name, v in Predictor(config).state_dict().items()}
    found = {name: tuple(value.shape) for name, value in weights.items()}
    wrong = sorted(name for name in wanted | found if wanted.get(name) != found.get(name))
    if wrong:
        raise ValueError(
            f"{wrong[0]} has the shape {found.get(wrong[0])}, wanted {wanted.get(wrong[0])}"
        )
