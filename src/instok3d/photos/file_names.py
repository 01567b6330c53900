"""Names of files as users and camera files write them, and the text in those files."""

import codecs
import os
import stat
import unicodedata
from collections.abc import Sequence
from pathlib import Path

IMAGE_SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".png", ".webp", ".tif", ".tiff", ".bmp", ".ppm", ".pgm", ".pnm"}
    | {".gif", ".avif", ".heic", ".heif"}
)
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # begins with the mark of UTF-16
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def given_path(text: str | Path) -> Path:
    """The path that a user gave; a leading ~ is the home folder unless a file has that name."""
    path = Path(text)
    if not str(path).startswith("~") or os.path.lexists(path):
        return path
    try:
        return path.expanduser()
    except RuntimeError:  # no user of this name: it is the name of a file, which is not there
        return path


def check_regular_file(path: Path) -> None:
    """Refuse what is no file with an end, before anything waits for its bytes.

    Raises:
        FileNotFoundError: Nothing is there, or a link that leads nowhere or round in a circle.
        PermissionError: A folder on the way may not be entered.
        ValueError: It is a folder, a named pipe, a socket or a device.
    """
    try:
        mode = path.stat().st_mode
    except PermissionError as error:
        raise PermissionError(f"{path} may not be read; change its permissions") from error
    except OSError as error:  # also a circle of links, or a name that is too long
        if os.path.islink(path):
            raise FileNotFoundError(f"the link {path} leads to no file; remove it") from error
        raise FileNotFoundError(f"there is no file {path}") from error
    if stat.S_ISREG(mode):
        return
    kind = next((name for test, name in _KINDS if test(mode)), "a folder")
    raise ValueError(f"{path} is {kind}, wanted a file")


def read_text(path: Path) -> str:
    """The text of a file: UTF-8, or what its byte order mark says. The mark is left out.

    Bytes that are no text stay as surrogates, as in the names of files, so that a name that a
    program wrote without an encoding still finds its file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no regular file, or not in the encoding that its mark says.
    """
    check_regular_file(path)
    data = path.read_bytes()
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            errors = "surrogateescape" if encoding == "utf-8" else "strict"
            return data[len(mark) :].decode(encoding, errors)
    return data.decode("utf-8", "surrogateescape")


def shortened(names: Sequence[str], most: int = 5) -> str:
    """The first few names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if names[most:] else "")


def portable(name: str) -> str:
    """A path of a camera file with forward slashes, without ./ at its beginning."""
    name = name.replace("\\", "/")
    while name.startswith("./"):
        name = name[2:].lstrip("/")
    return name


def picture_stem(name: str) -> str:
    """A name without the ending of a picture; other parts behind dots stay (frame.0001)."""
    stem, suffix = os.path.splitext(name)
    return stem if suffix.lower() in IMAGE_SUFFIXES else name


def loose_key(name: str) -> str:
    """What names share that mean one photo: ending, letter case and Unicode form do not count."""
    return unicodedata.normalize("NFC", picture_stem(portable(name))).casefold()


def entry_of_any_case(folder: Path, name: str) -> Path | None:
    """The file or folder of a name in a folder; in another letter case if there is only one.

    Raises:
        ValueError: Several entries have the name in other letter cases.
    """
    if (folder / name).exists():
        return folder / name
    if not folder.is_dir():
        return None
    found = [entry for entry in folder.iterdir() if entry.name.casefold() == name.casefold()]
    if len(found) > 1:
        names = ", ".join(sorted(entry.name for entry in found))
        raise ValueError(f"{folder} holds {names}, which differ only in letter case; keep one")
    return found[0] if found else None


class NamedFiles:
    """Finds the files that a camera file names, relative to a folder.

    A camera file may come from elsewhere: names that lead out of the folder are refused.
    """

    def __init__(self, folder: Path, camera_file: Path, *, allow_outside: bool = False) -> None:
        self.folder = folder
        self._camera_file = camera_file
        self._allow_outside = allow_outside
        self._photos: dict[Path, dict[str, list[Path]]] = {}

    def place(self, name: str) -> Path:
        """Where a file of this name would be, whether it is there or not.

        Raises:
            ValueError: It would be outside of the folder, which was not allowed.
        """
        path = self.folder / name
        if "\\" in name and not path.exists():
            path = self.folder / portable(name)
        if not self._allow_outside and not self._is_inside(name, path):
            raise ValueError(
                f"{self._camera_file} names {name}, which lies outside of the folder "
                f"{self.folder}; if that is meant, pass --allow-outside"
            )
        return path

    def photo(self, name: str) -> Path | None:
        """The photo of this name, perhaps with another ending; None if it is not there.

        Raises:
            ValueError: Several photos differ only in their ending; or as for `place`.
        """
        path = self.place(name)
        if path.is_file():
            return path
        photos = self._photos_in(path.parent).get(loose_key(path.name), [])
        if len(photos) > 1:
            raise ValueError(
                f"{self._camera_file} names {name}, which may be "
                f"{' or '.join(photo.name for photo in photos)} in {path.parent}; keep one"
            )
        return photos[0] if photos else None

    def _is_inside(self, name: str, path: Path) -> bool:
        if os.name != "nt" and portable(name)[1:3] == ":/":  # C:/ of another machine
            return False
        folder, whole = os.path.abspath(self.folder), os.path.abspath(path)
        try:
            return os.path.commonpath([folder, whole]) == folder
        except ValueError:  # on two drives
            return False

    def _photos_in(self, folder: Path) -> dict[str, list[Path]]:
        if folder not in self._photos:
            found: dict[str, list[Path]] = {}
            for entry in sorted(folder.iterdir()) if folder.is_dir() else []:
                if entry.suffix.lower() in IMAGE_SUFFIXES and entry.is_file():
                    found.setdefault(loose_key(entry.name), []).append(entry)
            self._photos[folder] = found
        return self._photos[folder]
