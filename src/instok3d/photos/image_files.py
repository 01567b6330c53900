"""Which files are meant: a folder, files, a glob pattern or a video become a list of photos."""

import fnmatch
import glob
import os
import re
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from instok3d.photos.file_names import (
    IMAGE_SUFFIXES,
    check_regular_file,
    given_path,
    shortened,
)
from instok3d.photos.image_decoding import is_picture
from instok3d.photos.video import VIDEO_SUFFIXES, extract_frames

_THUMBNAIL = re.compile(r"(^|[._-])thumb(s|nail|nails)?([._-]|$)", re.IGNORECASE)
_frame_folders: list[tempfile.TemporaryDirectory[str]] = []  # each is removed when Python ends


class NoPhotosError(ValueError):
    """A folder or a pattern that is there, but with no photo in it."""


def find_images(
    source: str | Path | Sequence[str | Path], *, frames_folder: Path | None = None
) -> list[Path]:
    """The photos that a folder, a file, a glob pattern, a video, or a list of files stands for.

    Folders and patterns come out in natural order (2 before 10); a list keeps its own order. A
    folder's hidden files, thumbnails, subfolders and files of other kinds are left out with a
    warning that names them.

    Args:
        source: Folders are not searched below their first level.
        frames_folder: Where the frames of a video go; a temporary folder by default, which lasts
            as long as the process.

    Raises:
        FileNotFoundError: Nothing is there, or the pattern matches nothing.
        PermissionError: A folder may not be listed.
        NoPhotosError: No photo is in the folder, or none fits the pattern.
        ValueError: The list is empty or names a folder, or a video cannot be read.
    """
    if isinstance(source, Sequence) and not isinstance(source, str):
        return _list_files(source)
    path = given_path(source)
    if path.is_dir():
        return _list_folder(path)
    if not os.path.lexists(path):
        if glob.has_magic(str(source)):
            return _list_pattern(path)
        raise FileNotFoundError(f"there is no file or folder {source}")
    check_regular_file(path)
    if _may_be_video(path):
        return extract_frames(path, frames_folder or _temporary_folder())
    return [path]


def natural_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """A sort key under which numbers within names count as numbers."""
    parts = re.findall(r"\d+|\D+", str(path))
    key = [(0, int(p), "") if p.isdecimal() else (1, 0, p.casefold()) for p in parts]
    return key, str(path)


def _may_be_video(path: Path) -> bool:
    """By its bytes, not by its name: whether no picture format knows it."""
    suffix = path.suffix.lower()
    if suffix in IMAGE_SUFFIXES or (path.stat().st_size == 0 and suffix not in VIDEO_SUFFIXES):
        return False  # the decoder of pictures says best what is wrong with these
    return not is_picture(path)


def _list_files(source: Sequence[str | Path]) -> list[Path]:
    paths = [given_path(item) for item in source]
    if not paths:
        raise ValueError("no photo was given: the list of files is empty")
    for path in paths:
        if path.is_dir():
            raise ValueError(f"a list of photos holds the folder {path}; give files, or it alone")
        check_regular_file(path)
    unique = list(dict.fromkeys(paths))
    if len(unique) < len(paths):
        warnings.warn(
            f"{len(paths) - len(unique)} of {len(paths)} files were given twice and are used once",
            stacklevel=3,
        )
    return unique


def _list_pattern(pattern: Path) -> list[Path]:
    folder, *parts = pattern.parts if pattern.anchor else (".", *pattern.parts)
    found = sorted(dict.fromkeys(_matches(Path(folder), parts)), key=natural_key)
    if not found:
        raise FileNotFoundError(f"no file matches the pattern {pattern}")
    return _photos_among(found, f"the pattern {pattern}")


def _matches(folder: Path, parts: list[str]) -> Iterator[Path]:
    """What a glob pattern fits below a folder; ** does not follow links, which may go round."""
    if not parts:
        yield folder
        return
    first, *rest = parts
    if not glob.has_magic(first):
        if os.path.lexists(folder / first):
            yield from _matches(folder / first, rest)
        return
    entries = _entries_of(folder)
    if first == "**":
        yield from _matches(folder, rest or ["*"])
        below = [entry for entry in entries if entry.is_dir() and not entry.is_symlink()]
        for entry in below:
            if not entry.name.startswith("."):
                yield from _matches(entry, parts)
        return
    for entry in entries:
        hidden = entry.name.startswith(".") and not first.startswith(".")
        if fnmatch.fnmatch(entry.name, first) and not hidden:
            yield from _matches(entry, rest)


def _list_folder(folder: Path) -> list[Path]:
    try:
        entries = sorted(folder.iterdir(), key=natural_key)
    except PermissionError as error:
        raise PermissionError(
            f"the folder {folder} may not be listed; change its permissions"
        ) from error
    return _photos_among(entries, f"the folder {folder}")


def _photos_among(entries: list[Path], where: str) -> list[Path]:
    photos = [path for path in entries if is_photo(path)]
    others = [path.name for path in entries if not is_photo(path)]
    if not photos:
        raise NoPhotosError(f"{where} holds no photo{_hint(entries, others)}")
    if others:
        warnings.warn(
            f"{len(others)} of {len(entries)} entries of {where} are not photos and were left "
            f"out: {shortened(others)}",
            stacklevel=4,
        )
    return photos


def is_photo(path: Path) -> bool:
    """Whether a file in a folder is taken for a photo, by its name; hidden ones are not."""
    return (
        not path.name.startswith(".")
        and path.suffix.lower() in IMAGE_SUFFIXES
        and not _THUMBNAIL.search(path.stem)
        and path.is_file()
    )


def _hint(entries: list[Path], others: list[str]) -> str:
    """What to give instead: a subfolder with photos or the video that lies there."""
    fuller = [p.name for p in entries if p.is_dir() and any(map(is_photo, _entries_of(p)))]
    videos = [p.name for p in entries if p.suffix.lower() in VIDEO_SUFFIXES]
    if fuller:
        return f" itself; give one of its folders: {shortened(fuller)}"
    if videos:
        return f"; give a video in it as the input: {shortened(videos)}"
    return f", only {shortened(others)}" if others else "; it is empty"


def _entries_of(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _temporary_folder() -> Path:
    folder = tempfile.TemporaryDirectory(prefix="instok3d_frames_")
    _frame_folders.append(folder)
    return Path(folder.name)
