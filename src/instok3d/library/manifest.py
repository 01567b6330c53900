"""The manifest of a library: which shards count, and which of their scenes do not."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from instok3d.files import replacing
from instok3d.library.entries import Encoder
from instok3d.reading import naming_damage, one_line, read_json, text, whole_number
from instok3d.version import __version__

NAME = "library.json"
FORMAT = "instok3d-library"
VERSION = 1
REMEDY = "bring it back from a copy, or make the library again from its scenes"


@dataclass(frozen=True)
class ShardRecord:
    """A shard that counts."""

    file: str
    """Name in shards/."""
    rows: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """All that changes in a library: whatever the manifest does not name is not in it."""

    encoder: Encoder | None = None
    shards: tuple[ShardRecord, ...] = ()
    removed: frozenset[int] = frozenset()
    """Numbers of additions that lie in a shard and do not count."""
    next_addition: int = 1
    next_shard: int = 1


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a library.

    Raises:
        FileNotFoundError: There is no library.
        ValueError: It is damaged, or of a newer version.
    """
    path = folder / NAME
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no library {folder} (no {NAME} in it): `instok3d library add` makes one"
        )
    value = read_json(path, REMEDY)
    with naming_damage(path, REMEDY):
        if text(value["format"]) != FORMAT:
            raise ValueError(f"its format is {value['format']!r}, not {FORMAT!r}")
        if (version := whole_number(value["version"], 1)) > VERSION:
            raise ValueError(
                f"{path} is of version {version}, made by a newer instok3d; this one reads "
                f"version {VERSION}: update it"
            )
        encoder = value["encoder"]
        return Manifest(
            encoder=None if encoder is None else Encoder(
                one_line(encoder["name"]), whole_number(encoder["channels"], 1)
            ),
            shards=tuple(_record(each) for each in value["shards"]),
            removed=frozenset(whole_number(each) for each in value["removed"]),
            next_addition=whole_number(value["next_addition"], 1),
            next_shard=whole_number(value["next_shard"], 1),
        )  # fmt: skip


def _record(value: dict[str, object]) -> ShardRecord:
    name = one_line(value["file"])
    if Path(name).name != name or not name.endswith(".safetensors"):
        raise ValueError(f"{name!r} is no name of a shard")
    return ShardRecord(name, whole_number(value["rows"]), text(value["sha256"]))


def write_manifest(folder: Path, manifest: Manifest, *, new: bool = False) -> None:
    """Make a manifest count, at once and whole.

    Args:
        folder: The library.
        manifest: What it holds.
        new: Leave one that is there as it is.

    Raises:
        FileExistsError: It is to be a new one, and there is one.
    """
    value = {
        "format": FORMAT,
        "version": VERSION,
        "generator": f"instok3d {__version__}",
        **asdict(manifest),
        "removed": sorted(manifest.removed),
    }
    with replacing(folder / NAME, overwrite=not new) as part:
        part.write_text(json.dumps(value, indent=1) + "\n")
