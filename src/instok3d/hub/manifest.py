"""instok3d.json: which files of a repository make up the model or the scene, with their hashes."""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from instok3d.files import json_text, sha256_of
from instok3d.hub.references import WORD
from instok3d.reading import naming_damage, one_of, read_json, text, whole_number

FORMAT = "instok3d-hub-1"
FILE = "instok3d.json"
REMEDY = "push it again, or take another commit"
MODEL, SEMANTICS = "model.safetensors", "semantics.safetensors"

Kind = Literal["model", "scene"]
ALLOWED: dict[Kind, re.Pattern[str]] = {
    "model": re.compile(rf"({MODEL}|{SEMANTICS})".replace(".", r"\.")),
    "scene": re.compile(
        rf"(scene|cameras|objects)\.json|edits\.jsonl|(gaussians|tokens)\.safetensors"
        rf"|(semantics|edits)/{WORD}\.safetensors|(previews/)?inputs/\d+\.png"
        r"|previews/contact_sheet\.png"
    ),
}
"""Names of files, by what they make up: JSON, safetensors and PNG, nothing that runs code. Others
are neither pushed nor fetched."""
NEEDED: dict[Kind, str] = {"model": MODEL, "scene": "scene.json"}


@dataclass(frozen=True)
class HubFile:
    """A file as it must be."""

    sha256: str
    bytes: int


@dataclass(frozen=True)
class Manifest:
    """What a repository holds."""

    kind: Kind
    files: Mapping[str, HubFile]
    """By their path in the repository, with slashes."""

    def to_json(self) -> str:
        """The text of the file."""
        files = {name: asdict(each) for name, each in self.files.items()}
        return json_text({"format": FORMAT, "kind": self.kind, "files": files}) + "\n"


def manifest_of(kind: Kind, files: Mapping[str, Path]) -> Manifest:
    """The manifest of files that are here, by their path in the repository."""
    return Manifest(
        kind,
        {
            name: HubFile(sha256_of(path), path.stat().st_size)
            for name, path in sorted(files.items())
        },
    )


def read_manifest(path: Path, kind: Kind, where: object) -> Manifest:
    """The manifest of a repository.

    Args:
        path: The file.
        kind: What the repository is to hold.
        where: Its name, for messages.

    Raises:
        ValueError: It is damaged, of a newer version, holds something else, or names a file that
            is none of a model or a scene.
    """
    value = read_json(path, REMEDY)
    with naming_damage(f"{FILE} of {where}", REMEDY):
        if value["format"] != FORMAT:
            raise ValueError(f"its format is {value['format']!r}, this program reads {FORMAT!r}")
        found = one_of(value["kind"], tuple(ALLOWED))
        if found != kind:
            raise ValueError(f"it holds a {found}, wanted a {kind}")
        files = {name: _file(name, each, kind) for name, each in dict(value["files"]).items()}
        if NEEDED[kind] not in files:
            raise ValueError(f"it lacks {NEEDED[kind]}")
    return Manifest(kind, files)


def _file(name: str, value: Any, kind: Kind) -> HubFile:
    if not ALLOWED[kind].fullmatch(name):
        raise ValueError(f"it names {name!r}, which is no file of a {kind}")
    digest = text(value["sha256"])
    if not re.fullmatch("[0-9a-f]{64}", digest):
        raise ValueError(f"the SHA-256 of {name} is none")
    return HubFile(digest, whole_number(value["bytes"]))
