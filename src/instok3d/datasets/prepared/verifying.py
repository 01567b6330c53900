"""Looking for what is missing or damaged in a prepared folder."""

from collections.abc import Iterator, Set
from dataclasses import dataclass
from pathlib import Path

from instok3d.datasets.prepared.format import RECORD, read_scene
from instok3d.datasets.prepared.index import INDEX, read_index, scene_folders
from instok3d.datasets.prepared.masks import MASKS_RECORD, read_masks_record
from instok3d.files import sha256_of

UNFINISHED = (".part", ".old")
"""The second is of earlier versions."""
LEFT = "was left by a run that was stopped, or is of one at work; delete it if none is"


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong in a prepared folder."""

    path: str
    """Below the prepared folder."""
    problem: str


def verify(folder: Path) -> Iterator[Fault]:
    """Everything that is missing, damaged or too much in a prepared folder, file by file.

    Every byte is read and compared with its checksum.

    Raises:
        FileNotFoundError: There is no such folder.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    yield from verify_index(folder)
    for scene in scene_folders(folder):
        yield from verify_scene(scene)


def verify_index(folder: Path) -> Iterator[Fault]:
    """How the index differs from the scenes that lie there, and what no scene owns."""
    lying = {scene.name: scene for scene in scene_folders(folder)}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") and path.suffix in UNFINISHED:
            yield Fault(path.name, LEFT)
        elif path.is_dir() and path.name not in lying and not path.name.startswith("."):
            yield Fault(path.name, f"is a folder without {RECORD}")
    try:
        listed = read_index(folder)
    except (FileNotFoundError, ValueError) as error:
        yield Fault(INDEX, str(error))
        return
    for name in sorted(lying.keys() | listed.keys()):
        if name not in lying:
            yield Fault(name, "is in the index but not in the folder")
        elif name not in listed:
            yield Fault(name, "is not in the index; `instok3d data verify --index` adds it")
        elif listed[name].get("sha256") != sha256_of(lying[name] / RECORD):
            yield Fault(f"{name}/{RECORD}", "is not the one that the index was made of")


def verify_scene(scene: Path) -> Iterator[Fault]:
    """Everything that is wrong in one scene folder."""
    try:
        record = read_scene(scene)
    except ValueError as error:
        yield Fault(f"{scene.name}/{RECORD}", str(error))
        return
    if record.info.name != scene.name:
        yield Fault(f"{scene.name}/{RECORD}", f"belongs to the scene {record.info.name}")
    listed, records = dict(record.files), {RECORD}
    for masks in sorted(scene.glob(f"masks_*/{MASKS_RECORD}")):
        records.add(masks.relative_to(scene).as_posix())
        try:
            files = read_masks_record(masks.parent).files
        except ValueError as error:
            yield Fault(masks.relative_to(scene.parent).as_posix(), str(error))
            continue
        listed |= {f"{masks.parent.name}/{name}": value for name, value in files.items()}
    for name, (size, sha256) in listed.items():
        problem = _file_problem(scene / name, size, sha256)
        if problem:
            yield Fault(f"{scene.name}/{name}", problem)
    yield from _unlisted(scene, listed.keys() | records)


def _unlisted(scene: Path, known: Set[str]) -> Iterator[Fault]:
    """What lies in a scene folder and is in no record; a lock is none of its files."""
    for path in sorted(scene.iterdir()):
        hidden = path.name.startswith(".")
        if hidden and path.suffix in UNFINISHED:
            yield Fault(f"{scene.name}/{path.name}", LEFT)
        elif not (hidden and path.suffix == ".lock"):
            for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
                name = file.relative_to(scene).as_posix()
                if file.is_file() and name not in known:
                    yield Fault(f"{scene.name}/{name}", "is not listed in the scene's record")


def _file_problem(path: Path, size: int, sha256: str) -> str | None:
    if not path.is_file():
        return "is missing"
    found = path.stat().st_size
    if found != size:
        return f"has {found} bytes, should have {size}"
    return None if sha256_of(path) == sha256 else "is damaged: its checksum differs"
