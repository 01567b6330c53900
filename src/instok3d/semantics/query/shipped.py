"""Which encoder answers questions about a scene: that which comes with instok3d, or a given one."""

import json
from collections.abc import Collection
from functools import lru_cache
from pathlib import Path

from safetensors import safe_open

from instok3d.errors import MissingWeightsError
from instok3d.reading import naming_damage, parse_json
from instok3d.semantics.query.calibration import Calibration
from instok3d.semantics.query.encoder import QueryEncoder
from instok3d.semantics.teachers.file import REMEDY, load_teacher
from instok3d.semantics.teachers.opening import open_teacher

SHIPPED = Path(__file__).parents[2] / "assets" / "default_semantics.safetensors"
"""The default model's semantics; the calibration lies in its metadata."""
CALIBRATION = "query.calibration"


def find_encoder(scene: Collection[str], teacher: str | None = None) -> QueryEncoder:
    """The encoder for a scene.

    Args:
        scene: Names of the encoders that saw it.
        teacher: Another one than that which comes with instok3d, as `open_teacher` takes it. It is
            read by a calibration that was fitted for the other one.

    Raises:
        ValueError: No encoder saw the scene, or another one did.
        FileNotFoundError: There are no such weights (MissingWeightsError for the shipped ones).
    """
    if not scene:
        raise ValueError(
            "this scene has no semantics: no encoder saw its photos; reconstruct it with "
            "semantics to search it"
        )
    encoder = _shipped(SHIPPED) if teacher is None else QueryEncoder(open_teacher(teacher))
    if encoder.teacher.name not in scene:
        raise ValueError(
            f"this scene has no semantics of {encoder.teacher.name!r}, but of "
            f"{', '.join(scene)}: give that encoder's weights (--teacher)"
        )
    return encoder


def shipped_encoder(scene: Collection[str]) -> QueryEncoder | None:
    """The encoder that comes with instok3d, if it is there and saw a scene."""
    if not SHIPPED.is_file():
        return None
    encoder = _shipped(SHIPPED)
    return encoder if encoder.teacher.name in scene else None


def save_calibration(calibration: Calibration) -> dict[str, str]:
    """Metadata for a file that holds an encoder."""
    return {CALIBRATION: json.dumps(calibration.to_json())}


def load_encoder(path: Path) -> QueryEncoder:
    """The encoder of a file, with its calibration where it holds one.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds no encoder, or is damaged.
    """
    teacher = load_teacher(path)
    with naming_damage(path, REMEDY):
        with safe_open(path, "pt") as file:
            kept = (file.metadata() or {}).get(CALIBRATION)
        if kept is None:
            return QueryEncoder(teacher)
        value = parse_json(kept, "its calibration", REMEDY)
        return QueryEncoder(teacher, Calibration.from_json(value))


@lru_cache(maxsize=1)
def _shipped(path: Path) -> QueryEncoder:
    if not path.is_file():
        raise MissingWeightsError(
            f"the encoder that reads texts is not there: {path} is missing; give another one "
            "(--teacher), or take a whole copy of instok3d"
        )
    return load_encoder(path)
