"""The tables of a PLY file of any kind, checked against the file's size before they are read."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from instok3d.reading import naming_damage

HEADER_LIMIT_BYTES = 128 * 1024
REMEDY = "export it again"
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4",
    "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
ENCODINGS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
"""Byte orders."""


@dataclass(frozen=True)
class Element:
    """One table of a PLY file."""

    name: str
    count: int
    """Rows."""
    columns: tuple[tuple[str, str], ...] | None
    """Name and numpy type of each column; None where rows have lists, as faces of meshes do."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the columns."""
        return tuple(name for name, _ in self.columns or ())

    @property
    def row_type(self) -> np.dtype:
        """Of one row."""
        return np.dtype(list(self.columns or ()))


@dataclass(frozen=True)
class PlyHeader:
    """What stands before the rows of a PLY file."""

    encoding: str
    """One of ENCODINGS."""
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    num_bytes: int
    """Of the header: where the rows begin."""

    def element(self, name: str) -> Element | None:
        """The table of a name, None where there is none."""
        return next((each for each in self.elements if each.name == name), None)


def read_header(path: Path) -> PlyHeader:
    """The header of a PLY file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is none, or the file has another size than it promises.
    """
    with path.open("rb") as stream:
        head = stream.read(HEADER_LIMIT_BYTES)
    end = head.find(b"end_header")
    after = head[end + 10 : end + 12]
    if not head.startswith(b"ply") or end < 0 or after[:1] not in (b"\n", b"\r"):
        raise ValueError(f"{path} is not a PLY file: no header found in its first bytes")
    text = head[:end].decode("ascii", "replace").splitlines()[1:]
    comments = tuple(line[8:].strip() for line in text if line.startswith("comment "))
    lines = [line.split() for line in text]
    lines = [line for line in lines if line and line[0] not in ("comment", "obj_info")]
    first = lines[0] if lines else []
    if len(first) != 3 or first[0] != "format" or first[1] not in ENCODINGS or first[2] != "1.0":
        found = " ".join(first)[:100] or "nothing"
        raise ValueError(f"{path}: wanted format {' or '.join(ENCODINGS)} 1.0, found {found}")
    elements = _elements(path, lines[1:], ENCODINGS[first[1]])
    newline = 2 if after == b"\r\n" else 1
    header = PlyHeader(first[1], elements, comments, end + 10 + newline)
    _check_size(path, header)
    return header


def read_table(path: Path, header: PlyHeader, element: Element) -> np.ndarray:
    """The rows of one element as a structured array.

    Raises:
        ValueError: They come behind rows that hold lists, or are damaged.
    """
    before = header.elements[: header.elements.index(element)]
    if any(each.columns is None for each in (*before, element)):
        raise ValueError(f"{path}: the element {element.name[:100]!r} cannot be read behind lists")
    if header.encoding == "ascii":
        skipped = sum(each.count for each in before)
        return _read_text(path, header, element, skipped)
    offset = header.num_bytes + sum(each.count * each.row_type.itemsize for each in before)
    rows = np.fromfile(path, dtype=element.row_type, count=element.count, offset=offset)
    if len(rows) != element.count:
        raise ValueError(f"{path} was cut short while it was read")
    return rows


def _elements(path: Path, lines: Sequence[Sequence[str]], order: str) -> tuple[Element, ...]:
    elements: list[Element] = []
    for line in lines:
        if line[0] == "element":
            digits = line[2] if len(line) == 3 else ""
            if not digits.isdecimal() or len(digits) > 18:
                raise ValueError(f"{path}: cannot read the line '{' '.join(line)[:100]}'")
            elements.append(Element(line[1], int(digits), ()))
        elif line[0] == "property" and elements:
            last = elements[-1]
            elements[-1] = Element(last.name, last.count, _with_column(path, last, line, order))
        else:
            raise ValueError(f"{path}: cannot read the line '{' '.join(line)[:100]}'")
    for each in elements:
        if len(set(each.names)) != len(each.names):
            raise ValueError(f"{path}: doubled columns in the element {each.name[:100]!r}")
    return tuple(elements)


def _with_column(
    path: Path, element: Element, line: Sequence[str], order: str
) -> tuple[tuple[str, str], ...] | None:
    if element.columns is None or line[1:2] == ["list"]:
        return None
    if len(line) != 3 or line[1] not in TYPES:
        raise ValueError(f"{path}: cannot read the property '{' '.join(line)[:100]}'")
    return (*element.columns, (line[2], order + TYPES[line[1]]))


def _check_size(path: Path, header: PlyHeader) -> None:
    """Compare the file's size with the header; rows of text or with lists have a least size."""
    exact, want = header.encoding != "ascii", header.num_bytes
    for each in header.elements:
        if each.columns is None:
            exact = False
            want += each.count
        elif header.encoding == "ascii":
            want += max(0, 2 * len(each.columns) * each.count - 1)  # a digit and what ends it
        else:
            want += each.count * each.row_type.itemsize
    have = path.stat().st_size
    if have < want or (exact and have != want):
        rows = ", ".join(f"{each.count} of {each.name[:40]!r}" for each in header.elements[:10])
        raise ValueError(
            f"{path}: its header promises rows ({rows}) in {'' if exact else 'at least '}{want} "
            f"bytes but the file has {have}; it is cut short or damaged"
        )


def _read_text(path: Path, header: PlyHeader, element: Element, skipped: int) -> np.ndarray:
    """Rows of numbers in ASCII."""
    if not element.count:
        return np.zeros(0, element.row_type)
    with path.open("rb") as stream:
        stream.seek(header.num_bytes)
        with naming_damage(path, REMEDY), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of too few rows, which are refused below
            rows = np.loadtxt(
                stream, dtype=element.row_type, comments=None, skiprows=skipped,
                max_rows=element.count, ndmin=1, encoding="ascii",
            )  # fmt: skip
    if len(rows) != element.count:
        raise ValueError(
            f"{path}: its header promises {element.count} rows of {element.name[:40]!r}, found "
            f"{len(rows)}; it is cut short or damaged"
        )
    return rows
