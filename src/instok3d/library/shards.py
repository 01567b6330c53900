"""Shards of a library: safetensors files that are written once and read through a memory map."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from instok3d.files import replacing
from instok3d.library.entries import Entry, SceneEntries
from instok3d.reading import naming_damage, one_line, parse_json, text, whole_number

FORMAT = "instok3d-library-shard-1"
REMEDY = "run `instok3d library verify`, and add what it misses again"
LARGEST_HEADER = 100_000_000
"""Bytes; the limit of the format's own reader."""
ROWS_AT_ONCE = 16_384
COLUMNS: dict[str, tuple[str, Any]] = {
    "embeddings": ("F16", np.float16),
    "additions": ("I64", np.int64),
    "ids": ("I32", np.int32),
    "boxes": ("F32", np.float32),
    "text_ends": ("I64", np.int64),
    "thumbnail_ends": ("I64", np.int64),
    "texts": ("U8", np.uint8),
    "thumbnails": ("U8", np.uint8),
}
"""Columns of a shard. Texts and thumbnails lie behind each other; where each ends is a column."""


@dataclass(frozen=True)
class Addition:
    """One scene as it was added once: never changed, only left out."""

    number: int
    """Counts the additions of a library; no number is given twice."""
    scene: str
    rows: int


@dataclass(frozen=True)
class Source:
    """Rows to be written."""

    columns: Mapping[str, np.ndarray]
    """One for each of COLUMNS."""
    rows: Int[np.ndarray, " row"]

    def pieces(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Where the texts, or the thumbnails, of the rows begin and end."""
        ends = self.columns[f"{name}_ends"]
        starts = np.concatenate([[0], ends[:-1]]) if len(ends) else ends
        return starts[self.rows], ends[self.rows]

    def values(self, name: str) -> Iterator[np.ndarray]:
        """A column of the rows, in parts that fit in memory."""
        column = self.columns[name]
        for place in range(0, len(self.rows), ROWS_AT_ONCE):
            rows = self.rows[place : place + ROWS_AT_ONCE]
            if name in ("texts", "thumbnails"):
                begins, ends = (
                    each[place : place + ROWS_AT_ONCE] for each in self.pieces(name[:-1])
                )
                found = [column[a:b].tobytes() for a, b in zip(begins, ends, strict=True)]
                yield np.frombuffer(b"".join(found), np.uint8)
            else:
                yield column[rows]


class Shard:
    """An open shard. It stays readable after its file was removed.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with naming_damage(path, REMEDY):
            header, start = _read_header(path)
            size = path.stat().st_size - start
            self._columns = {name: _column(path, header, name, start, size) for name in COLUMNS}
            metadata = header["__metadata__"]
            if metadata["format"] != FORMAT:
                raise ValueError(f"its format is {metadata['format']!r}, not {FORMAT!r}")
            self.additions = tuple(
                Addition(whole_number(number), text(scene), whole_number(rows))
                for number, scene, rows in parse_json(metadata["scenes"], path, REMEDY)
            )
            rows = sum(each.rows for each in self.additions)
            by_row = ("embeddings", "additions", "ids", "boxes", "text_ends", "thumbnail_ends")
            shapes = {name: self._columns[name].shape for name in by_row}
            if any(shape[0] != rows for shape in shapes.values()):
                raise ValueError(f"its columns have {shapes} rows, its scenes {rows}")
            if len(shapes["embeddings"]) != 2 or shapes["boxes"][1:] != (2, 3):
                raise ValueError(f"its columns are of the shapes {shapes}")

    @property
    def rows(self) -> int:
        """Number of objects, those left out included."""
        return len(self.embeddings)

    @property
    def embeddings(self) -> np.ndarray:
        """Of unit length, [row, channel], float16."""
        return self._columns["embeddings"]

    @cached_property
    def scene_of(self) -> dict[int, str]:
        """The scene of each addition."""
        return {each.number: each.scene for each in self.additions}

    def left_out(self, removed: frozenset[int]) -> Bool[np.ndarray, " row"] | None:
        """Which rows belong to removed additions; None where none does."""
        here = removed.intersection(self.scene_of)
        if not here:
            return None
        return np.isin(self._columns["additions"], sorted(here))

    def addition_of(self, row: int) -> int:
        """The number of the addition that a row belongs to."""
        return int(self._columns["additions"][row])

    def row_of(self, addition: int, number: int) -> int | None:
        """The row of the object with an id in an addition; None where there is none."""
        rows = np.flatnonzero(self._columns["additions"] == addition)
        found = rows[self._columns["ids"][rows] == number]
        return int(found[0]) if len(found) else None

    def entry(self, row: int) -> Entry:
        """The object of a row.

        Raises:
            ValueError: Its description is damaged.
        """
        with naming_damage(self.path, REMEDY):
            words = parse_json(self._piece("text", row), f"{self.path}, row {row}", REMEDY)
            label = words["label"]
            return Entry(
                id=int(self._columns["ids"][row]),
                key=one_line(words["key"]),
                label=None if label is None else one_line(label),
                box=np.array(self._columns["boxes"][row]),
                thumbnail=self._piece("thumbnail", row),
            )

    def _piece(self, name: str, row: int) -> bytes:
        ends, whole = self._columns[f"{name}_ends"], self._columns[f"{name}s"]
        first, end = int(ends[row - 1]) if row else 0, int(ends[row])
        if not 0 <= first <= end <= len(whole):
            raise ValueError(f"the {name} of row {row} is to lie from {first} to {end}")
        return whole[first:end].tobytes()

    def source(self, removed: frozenset[int]) -> "Source":
        """What of it counts, to be written into another shard.

        Raises:
            ValueError: It does not say where texts and thumbnails lie.
        """
        for name in ("text", "thumbnail"):
            with naming_damage(self.path, REMEDY):
                ends = self._columns[f"{name}_ends"]
                bounds = np.concatenate([[0], ends, [len(self._columns[f"{name}s"])]])
                if (np.diff(bounds) < 0).any():
                    raise ValueError(f"the places of its {name}s are out of order")
        left_out = self.left_out(removed)
        kept = np.arange(self.rows) if left_out is None else np.flatnonzero(~left_out)
        return Source(self._columns, kept)

    def check(self) -> None:
        """Look at every value.

        Raises:
            ValueError: One cannot be right.
        """
        with naming_damage(self.path, REMEDY):
            for place in range(0, self.rows, ROWS_AT_ONCE):
                part = self.embeddings[place : place + ROWS_AT_ONCE].astype(np.float32)
                if not (np.abs(np.linalg.norm(part, axis=1) - 1) < 0.01).all():
                    raise ValueError("an embedding is not of unit length")
            counts = {each.number: each.rows for each in self.additions}
            numbers, found = np.unique(self._columns["additions"], return_counts=True)
            if dict(zip(numbers.tolist(), found.tolist(), strict=True)) != {
                number: rows for number, rows in counts.items() if rows
            }:
                raise ValueError("rows belong to other scenes than it names")
            for row in range(self.rows):
                self.entry(row)


def source_of(entries: SceneEntries, addition: int) -> Source:
    """The objects of one scene, to be written."""
    embeddings = entries.embeddings.astype(np.float32)
    embeddings = embeddings / np.linalg.norm(embeddings, axis=1, keepdims=True)
    texts = [
        json.dumps({"key": each.key, "label": each.label}, ensure_ascii=False).encode()
        for each in entries.objects
    ]
    thumbnails = [each.thumbnail for each in entries.objects]
    boxes = [each.box for each in entries.objects]
    columns = {
        "embeddings": embeddings.astype(np.float16),
        "additions": np.full(len(texts), addition, np.int64),
        "ids": np.array([each.id for each in entries.objects], np.int32),
        "boxes": np.array(boxes, np.float32).reshape(-1, 2, 3),
        "text_ends": np.cumsum([len(each) for each in texts], dtype=np.int64),
        "texts": np.frombuffer(b"".join(texts), np.uint8),
        "thumbnail_ends": np.cumsum([len(each) for each in thumbnails], dtype=np.int64),
        "thumbnails": np.frombuffer(b"".join(thumbnails), np.uint8),
    }
    return Source(columns, np.arange(len(texts)))


def write_shard(
    path: Path, additions: Sequence[Addition], sources: Sequence[Source], channels: int
) -> str:
    """Write a shard whole; gives its SHA-256.

    Args:
        path: The file to be; what is there, left by a killed writer, is replaced.
        additions: Scenes, in the order of their rows.
        sources: All rows.
        channels: Of an embedding.
    """
    sizes = {}
    for name in ("text", "thumbnail"):
        places = [source.pieces(name) for source in sources]
        sizes[name] = [ends - begins for begins, ends in places]
    count = sum(len(source.rows) for source in sources)
    shapes = {name: [count] for name in COLUMNS} | {
        "embeddings": [count, channels],
        "boxes": [count, 2, 3],
        "texts": [sum(int(each.sum()) for each in sizes["text"])],
        "thumbnails": [sum(int(each.sum()) for each in sizes["thumbnail"])],
    }
    scenes = json.dumps([[each.number, each.scene, each.rows] for each in additions])
    digest = hashlib.sha256()
    with replacing(path) as part, part.open("wb") as stream:

        def put(data: bytes | memoryview) -> None:
            stream.write(data)
            digest.update(data)

        put(_header(shapes, {"format": FORMAT, "scenes": scenes}))
        for name, (_, kind) in COLUMNS.items():
            if name.endswith("_ends"):
                lengths = sizes[name.removesuffix("_ends")]
                put(np.cumsum(np.concatenate([*lengths, np.zeros(0)]), dtype=kind).tobytes())
                continue
            for source in sources:
                for values in source.values(name):
                    put(np.ascontiguousarray(values, kind).tobytes())
        stream.flush()
    return digest.hexdigest()


def _header(shapes: dict[str, list[int]], metadata: dict[str, str]) -> bytes:
    header: dict[str, Any] = {"__metadata__": metadata}
    place = 0
    for name, (kind, dtype) in COLUMNS.items():
        size = int(np.prod(shapes[name])) * np.dtype(dtype).itemsize
        header[name] = {
            "dtype": kind,
            "shape": shapes[name],
            "data_offsets": [place, place + size],
        }
        place += size
    data = json.dumps(header, separators=(",", ":")).encode()
    data += b" " * (-len(data) % 8)
    return len(data).to_bytes(8, "little") + data


def _read_header(path: Path) -> tuple[Any, int]:
    with path.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        if not 0 < length <= LARGEST_HEADER:
            raise ValueError(f"its header has {length} bytes")
        data = stream.read(length)
    if len(data) != length:
        raise ValueError("it is cut off in its header")
    return parse_json(data, path, REMEDY), 8 + length


def _column(path: Path, header: Any, name: str, start: int, size: int) -> np.ndarray:
    """A column, mapped and not read."""
    kind, dtype = COLUMNS[name]
    said = header[name]
    shape = tuple(whole_number(each) for each in said["shape"])
    first, end = (whole_number(each) for each in said["data_offsets"])
    count = 1
    for each in shape:
        count *= each
    if said["dtype"] != kind or not shape or count * np.dtype(dtype).itemsize != end - first:
        raise ValueError(f"its column {name} is {said}")
    if end > size:
        raise ValueError(f"its column {name} is cut off")
    if count == 0:  # nothing cannot be mapped
        return np.zeros(shape, dtype)
    return np.memmap(path, dtype, "r", offset=start + first, shape=shape)
