"""Reading of binary glTF 2.0 files: their JSON, and the numbers that it refers to.

Files come from anywhere: every size is checked before anything is allocated, nothing outside the
file is opened, and what is not understood is refused. What the JSON means is up to the caller.
"""

import struct
from typing import Any

import numpy as np
from jaxtyping import Shaped

from instok3d.reading import one_of, parse_json, whole_number

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = b"glTF", 2, b"JSON", b"BIN\0"
COMPONENTS = {5120: "|i1", 5121: "|u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Numpy types of numbers, by component type."""
FLOAT = 5126
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
"""Columns of a row, by the type of an accessor."""


class GlbFile:
    """The two chunks of a file.

    All methods raise LookupError, TypeError or ValueError where the file is damaged: call them
    inside of `reading.naming_damage`.
    """

    def __init__(self, data: bytes) -> None:
        if data[:4] != MAGIC:
            raise ValueError("it is no GLB file")
        version, total = struct.unpack_from("<II", data, 4)
        if version != VERSION or total != len(data):
            raise ValueError(f"version {version} of {total} bytes, wanted 2 of {len(data)}")
        chunks: dict[bytes, bytes] = {}
        at = 12
        while at < total:
            length, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + length > total:
                raise ValueError("a chunk is cut off")
            chunks.setdefault(kind, data[at + 8 : at + 8 + length])
            at += 8 + length
        self.json: dict[str, Any] = parse_json(chunks[JSON_CHUNK], "its description", "")
        if not isinstance(self.json, dict):
            raise ValueError("its JSON holds no object")
        self.binary = chunks.get(BINARY_CHUNK, b"")

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """One of the "nodes", "meshes" and so on of the JSON."""
        items = self.json.get(kind, [])
        return items[whole_number(index, 0, len(items) - 1)]

    def view(self, index: Any) -> tuple[memoryview, int]:
        """The bytes of a buffer view, and its stride (0 = none given)."""
        view = self.item("bufferViews", index)
        whole_number(view["buffer"], 0, 0)
        if "uri" in self.item("buffers", 0):
            raise ValueError("its numbers lie outside the file")
        start = whole_number(view.get("byteOffset", 0), 0, len(self.binary))
        length = whole_number(view["byteLength"], 0, len(self.binary) - start)
        stride = whole_number(view.get("byteStride", 0), 0, 252)
        return memoryview(self.binary)[start : start + length], stride

    def values(
        self, index: Any, shapes: tuple[str, ...], kinds: tuple[int, ...]
    ) -> Shaped[np.ndarray, "row column"]:
        """The rows of an accessor; nothing is copied, so nothing is larger than the file.

        Args:
            index: Of the accessor.
            shapes: Types that are understood, of WIDTHS.
            kinds: Component types that are understood.
        """
        accessor = self.item("accessors", index)
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError("an accessor is sparse")
        shape = one_of(accessor["type"], shapes)
        kind = np.dtype(COMPONENTS[one_of(accessor["componentType"], kinds)])
        data, stride = self.view(accessor["bufferView"])
        width = WIDTHS[shape] * kind.itemsize
        stride = stride or width
        start = whole_number(accessor.get("byteOffset", 0), 0, len(data))
        count = whole_number(accessor["count"], 0, len(data))
        if stride < width or (count and start + stride * (count - 1) + width > len(data)):
            raise ValueError(f"accessor {index} reaches beyond its view")
        return np.ndarray((count, WIDTHS[shape]), kind, data, start, (stride, kind.itemsize))
