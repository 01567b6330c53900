"""Binary glTF files: accessors over one buffer, written whole; their numbers read again."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from instok3d.binary_gltf import (
    BINARY_CHUNK,
    COMPONENTS,
    FLOAT,
    JSON_CHUNK,
    MAGIC,
    VERSION,
    GlbFile,
)
from instok3d.files import replacing
from instok3d.reading import naming_damage

TYPES = {name: kind for kind, name in COMPONENTS.items()}
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
            "componentType": TYPES[rows.dtype.str],
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
        header = struct.pack("<4sII", MAGIC, VERSION, length)
        with replacing(path, overwrite=overwrite) as part:
            part.write_bytes(b"".join([header, *chunks]))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack("<I4s", len(data), kind) + data


class Glb(GlbFile):
    """A binary glTF file of Gaussians."""

    def floats(self, accessor: int) -> Float[np.ndarray, "row column"]:
        """The numbers of an accessor of float32; other numbers are refused.

        Raises:
            LookupError, TypeError, ValueError: It is damaged, or packs its numbers otherwise.
        """
        return self.values(accessor, tuple(SHAPES.values()), (FLOAT,))


def read_glb(path: Path) -> Glb:
    """The two parts of a binary glTF file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is damaged, or no binary glTF 2.
    """
    data = path.read_bytes()
    with naming_damage(path, REMEDY):
        return Glb(data)
