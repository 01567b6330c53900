"""Small GLB files and folders of them, as catalogues hold them."""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], np.uint16
)  # fmt: skip


def block(low: tuple[float, ...], high: tuple[float, ...], **material: Any) -> dict[str, Any]:
    """A box of one material in the file's frame: x right, y up, z to the front."""
    vertices = np.array(low) + CUBE * (np.array(high) - np.array(low))
    return {"vertices": vertices, "faces": CUBE_FACES, "material": material}


def table(width: float = 1.2, depth: float = 0.7, height: float = 0.75) -> list[dict[str, Any]]:
    """A red top on a grey column, centred, standing on y = 0."""
    x, z = width / 2, depth / 2
    top = block((-x, height - 0.04, -z), (x, height, z), factor=(0.5, 0.0, 0.0, 1.0))
    return [top, block((-0.05, 0, -0.05), (0.05, height - 0.04, 0.05))]


def square(texture: np.ndarray, alpha: str = "OPAQUE", side: float = 1.0) -> list[dict[str, Any]]:
    """An upright square that shows a picture to the front, its first row at the top."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * side
    uvs = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    material = {"texture": texture, "alpha": alpha}
    return [{"vertices": vertices, "faces": faces, "uvs": uvs, "material": material}]


class _Writer:
    def __init__(self) -> None:
        self.binary = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0}

    def add(self, kind: str, value: dict[str, Any]) -> int:
        self.json.setdefault(kind, []).append(value)
        return len(self.json[kind]) - 1

    def view(self, data: bytes) -> int:
        start = len(self.binary)
        self.binary += data + b"\0" * (-len(data) % 4)
        where = {"buffer": 0, "byteOffset": start, "byteLength": len(data)}
        return self.add("bufferViews", where)

    def values(self, array: np.ndarray, kind: str, component: int) -> int:
        dtype = {5126: "<f4", 5123: "<u2"}[component]
        view = self.view(np.ascontiguousarray(array, dtype).tobytes())
        accessor = {"bufferView": view, "componentType": component, "type": kind}
        return self.add("accessors", {**accessor, "count": len(array)})

    def material(self, factor: Any = None, texture: Any = None, alpha: str = "OPAQUE") -> int:
        look: dict[str, Any] = {"roughnessFactor": 1.0, "metallicFactor": 0.0}
        if factor is not None:
            look["baseColorFactor"] = list(factor)
        if texture is not None:
            stream = io.BytesIO()
            Image.fromarray(texture).save(stream, "PNG")
            view = self.view(stream.getvalue())
            image = self.add("images", {"bufferView": view, "mimeType": "image/png"})
            look["baseColorTexture"] = {"index": self.add("textures", {"source": image})}
        return self.add("materials", {"pbrMetallicRoughness": look, "alphaMode": alpha})


def glb(parts: list[dict[str, Any]], node: dict[str, Any] | None = None) -> bytes:
    """The file of some parts, under one node."""
    writer = _Writer()
    primitives = []
    for part in parts:
        attributes = {"POSITION": writer.values(part["vertices"], "VEC3", 5126)}
        if "uvs" in part:
            attributes["TEXCOORD_0"] = writer.values(part["uvs"], "VEC2", 5126)
        primitives.append({
            "attributes": attributes,
            "indices": writer.values(part["faces"].reshape(-1, 1), "SCALAR", 5123),
            "material": writer.material(**part["material"]),
        })  # fmt: skip
    mesh = writer.add("meshes", {"primitives": primitives})
    writer.add("nodes", {"mesh": mesh, **(node or {})})
    writer.add("scenes", {"nodes": [0]})
    writer.add("buffers", {"byteLength": len(writer.binary)})
    return pack(writer.json, writer.binary)


def pack(description: dict[str, Any], binary: bytes) -> bytes:
    """The two chunks as one file."""
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def unpack(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Description and numbers of a file of `pack`."""
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def write_furniture(folder: Path, models: dict[str, Any], **fields: Any) -> Path:
    """A catalogue of models by name: "Table" is written to Table.glb and so on."""
    folder.mkdir(parents=True, exist_ok=True)
    records = []
    for name, parts in models.items():
        (folder / f"{name}.glb").write_bytes(parts if isinstance(parts, bytes) else glb(parts))
        records.append({
            "file": f"{name}.glb", "name": name, "creator": "Ada", "license": "CC0-1.0", **fields
        })  # fmt: skip
    (folder / "catalog.json").write_text(json.dumps(records))
    return folder


def write_textures(folder: Path, textures: dict[str, tuple[str, np.ndarray]]) -> Path:
    """A catalogue of pictures by name: kind and sRGB bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    records = []
    for name, (kind, picture) in textures.items():
        Image.fromarray(picture).save(folder / f"{name}.png")
        records.append({
            "file": f"{name}.png", "kind": kind, "source": "Bea", "license": "MIT"
        })  # fmt: skip
    (folder / "catalog.json").write_text(json.dumps(records))
    return folder
