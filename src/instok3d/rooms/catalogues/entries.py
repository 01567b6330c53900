"""Entries of a catalogue: files of a folder with their licence and author, and who is credited."""

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from instok3d.files import json_text, sha256_of
from instok3d.reading import naming_damage, one_line, read_json

CATALOGUE = "catalog.json"
REMEDY = "correct it, or choose another folder"
LICENSES = re.compile(r"CC0(-1\.0)?|CC-BY-\d\.\d(-[A-Z]{2})?|MIT")
"""Licences under which pictures may go into a model that is given away, with credits."""


@dataclass(frozen=True)
class Entry:
    """One file of a catalogue that rooms may use."""

    file: Path
    """Inside the folder of the catalogue."""
    name: str
    creator: str
    license: str
    use: str
    """Generator that the model stands in for, or kind of surface of a texture."""
    elevation_m: float = 0.0
    """Of a model that hangs above the floor."""

    @property
    def stem(self) -> str:
        """The file's name without its ending."""
        return self.file.stem

    @property
    def credit(self) -> str:
        """One line for a list of credits."""
        return f"{self.name} ({self.stem}) by {self.creator}, {self.license}"


def read_catalogue(folder: Path, fields: Sequence[str]) -> list[dict[str, Any]]:
    """The records of a folder's catalog.json.

    Args:
        folder: Of the catalogue; files are named relative to it.
        fields: Text that every record has beside file and license.

    Raises:
        FileNotFoundError: There is no catalogue in the folder.
        ValueError: It is damaged, names files outside the folder, or two files of one name.
    """
    path = folder / CATALOGUE
    records = read_json(path, REMEDY)
    seen: set[str] = set()
    with naming_damage(path, REMEDY):
        if not isinstance(records, list):
            raise ValueError("it is no list of records")
        for number, record in enumerate(records, 1):
            if not isinstance(record, dict):
                raise ValueError(f"record {number} is no object")
            if missing := [key for key in ("file", "license", *fields) if key not in record]:
                raise ValueError(f"record {number} lacks {', '.join(missing)}")
            for key in ("file", "license", *fields):
                one_line(record[key])
            file = PurePosixPath(record["file"])
            if file.is_absolute() or ".." in file.parts or "\\" in record["file"]:
                raise ValueError(f"record {number} names a file outside the folder")
            if file.stem in seen:
                raise ValueError(f"two records name a file {file.stem!r}")
            seen.add(file.stem)
    return records


def usable_entries(
    folder: Path,
    kind: str,
    fields: Sequence[str],
    judged: Callable[[dict[str, Any]], tuple[Entry, str]],
) -> tuple[tuple[Entry, ...], dict[str, int]]:
    """The entries of a catalogue that rooms may use, and how many are left out for which reason.

    Args:
        folder: Of the catalogue.
        kind: What an entry is, in a word.
        fields: As of `read_catalogue`.
        judged: The entry of a record, and why it cannot be used; "" where it can.

    Raises:
        FileNotFoundError, ValueError: As `read_catalogue`, or nothing is usable.
    """
    entries: list[Entry] = []
    left_out: Counter[str] = Counter()
    for record in read_catalogue(folder, fields):
        entry, fault = judged(record)
        if fault:
            left_out[fault] += 1
        else:
            entries.append(entry)
    if not entries:
        raise ValueError(
            f"{folder} has no {kind} that rooms can use ({counted(left_out)}); choose another "
            "folder"
        )
    return tuple(entries), dict(left_out)


def digest(folder: Path, entries: Sequence[Entry]) -> str:
    """SHA-256 over the entries and the bytes of their files; the folder's place is left out."""
    rows = [
        [entry.file.as_posix(), entry.name, entry.creator, entry.license, entry.use,
         entry.elevation_m, sha256_of(folder / entry.file)]
        for entry in entries
    ]  # fmt: skip
    return hashlib.sha256(json_text(rows).encode("utf-8", "surrogateescape")).hexdigest()


def license_fault(entry: Entry) -> str:
    """Why the licence of an entry does not allow its use; "" where it does."""
    return "" if LICENSES.fullmatch(entry.license) else "licence other than CC0, CC-BY, MIT"


def counted(left_out: Mapping[str, int]) -> str:
    """Reasons with their numbers, the most frequent one first."""
    ordered = sorted(left_out.items(), key=lambda item: (-item[1], item[0]))
    return "; ".join(f"{count} {reason}" for reason, count in ordered) or "it is empty"
