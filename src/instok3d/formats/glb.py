"""Binary glTF files: accessors over one buffer, written whole; their numbers read again."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from instok3d.files import replacing
from instok3d.reading import naming_damage, parse_json, whole_number

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
COMPONENTS = {"<f4": 5126, "|u1": 5121, "<u4": 5125}
"""Component types of numbers, by numpy type."""
SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
REMEDY = "export it again"


class GlbBuilder:
    """Collects arrays and the JSON that refers to them."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._length = 0
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, *, bounds: bool = False, normalized: bool = False) -> int:
        """The index of a new accessor of float32, uint8 or uint32 values, a row for each item.

        Args:
            values: One or two axes, at least one row: glTF has no empty accessors.
            bounds: State the least and largest values, as positions must.
            normalized: The integers stand for numbers in [0, 1].
        """
        rows = np.ascontiguousarray(values).reshape(len(values), -1)
        data = rows.tobytes()
        data += b"\0" * (-len(data) % 4)
        self._views.append({"buffer": 0, "byteOffset": self._length, "byteLength": rows.nbytes})
        accessor: dict[str, Any] = {
            "bufferView": len(self._views) - 1,
            "componentType": COMPONENTS[rows.dtype.str],
            "count": len(rows),
            "type": SHAPES[rows.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor["min"], accessor["max"] = rows.min(0).tolist(), rows.max(0).tolist()
        self._accessors.append(accessor)
        self._chunks.append(data)
        self._length += len(data)
        return len(self._accessors) - 1

    def write(self, path: Path, content: dict[str, Any], *, overwrite: bool) -> None:
        """Write the file with the other parts of its JSON, atomically.

        Args:
            path: Where to.
            content: Asset, scenes, nodes, meshes and so on.
            overwrite: Replace a file that is there.

        Raises:
            FileExistsError: A file is there, and overwrite is off.
        """
        whole = dict(content)
        if self._accessors:
            whole["buffers"] = [{"byteLength": self._length}]
            whole |= {"bufferViews": self._views, "accessors": self._accessors}
        text = json.dumps(whole, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = [_chunk(JSON_CHUNK, text)]
        if self._accessors:
            chunks.append(_chunk(BINARY_CHUNK, b"".join(self._chunks)))
        length = 12 + sum(map(len, chunks))
        header = np.array([MAGIC, VERSION, length], "<u4").tobytes()
        with replacing(path, overwrite=overwrite) as part:
            part.write_bytes(b"".join([header, *chunks]))


def _chunk(kind: int, data: bytes) -> bytes:
    return np.array([len(data), kind], "<u4").tobytes() + data


@dataclass(frozen=True)
class Glb:
    """A binary glTF file."""

    content: dict[str, Any]
    """Its JSON."""
    data: bytes
    """Its buffer."""

    def floats(self, accessor: int) -> Float[np.ndarray, "row column"]:
        """The numbers of an accessor of float32, tightly packed.

        Raises:
            LookupError, TypeError, ValueError: It is damaged, or packs its numbers otherwise.
        """
        about = self.content["accessors"][whole_number(accessor)]
        view = self.content["bufferViews"][whole_number(about["bufferView"])]
        columns = {kind: count for count, kind in SHAPES.items()}.get(about["type"])
        if about["componentType"] != COMPONENTS["<f4"] or columns is None or "sparse" in about:
            raise ValueError("an accessor packs its numbers, which is not read")
        if view.get("byteStride", 4 * columns) != 4 * columns or view.get("buffer") != 0:
            raise ValueError("a buffer view is interleaved or of another file, which is not read")
        start = whole_number(view.get("byteOffset", 0)) + whole_number(about.get("byteOffset", 0))
        count = whole_number(about["count"]) * columns
        if start + 4 * count > len(self.data):
            raise ValueError("an accessor reaches beyond the buffer")
        return np.frombuffer(self.data, "<f4", count, start).reshape(-1, columns)


def read_glb(path: Path) -> Glb:
    """The two parts of a binary glTF file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is damaged, or no binary glTF 2.
    """
    data = path.read_bytes()
    with naming_damage(path, REMEDY):
        magic, version, length, json_length, kind = np.frombuffer(data, "<u4", 5).tolist()
        if (magic, version, kind) != (MAGIC, VERSION, JSON_CHUNK) or length != len(data):
            raise ValueError(f"{path} is no whole binary glTF file of version 2")
        content = parse_json(data[20 : 20 + json_length], path, REMEDY)
        if not isinstance(content, dict):
            raise ValueError("its JSON holds no object")
        rest = data[20 + json_length :]
        if not rest:
            return Glb(content, b"")
        length, kind = np.frombuffer(rest, "<u4", 2).tolist()
        if kind != BINARY_CHUNK or length > len(rest) - 8:
            raise ValueError("its second part is no whole buffer")
        return Glb(content, rest[8 : 8 + length])
