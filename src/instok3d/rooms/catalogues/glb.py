"""Models in binary glTF files: the triangles of the default scene with their base colours.

A reader of our own, because a model needs little of the format; what is not understood is refused
instead of left out.
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image
from scipy.spatial.transform import Rotation

from instok3d.binary_gltf import GlbFile
from instok3d.reading import naming_damage, number, one_of, whole_number

REMEDY = "take it out of the catalogue, or export it again as a plain GLB file"
MAX_BYTES = 64 * 2**20
MAX_CORNERS = 3_000_000
"""Triangle corners of a file."""
MAX_TEXELS = 16_000_000
MAX_PARTS = 1000
_TRIANGLES = 4


@dataclass(frozen=True)
class Surface:
    """The base colour of a part."""

    factor: Float[np.ndarray, "4"]
    """Linear red, green, blue and opacity; multiplies the picture."""
    picture: UInt8[np.ndarray, "height width 4"] | None
    """sRGB and opacity, row 0 at the top."""
    metallic: float
    roughness: float
    alpha: Literal["OPAQUE", "MASK", "BLEND"]
    cutoff: float
    """Texels of a MASK with less opacity are holes."""


@dataclass(frozen=True)
class GlbPart:
    """Triangles of one material, in the file's frame: x right, y up, z to the front."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    uvs: Float[np.ndarray, "vertex 2"] | None
    """v runs downwards from the top of the picture."""
    surface: Surface


def read_glb(path: Path) -> list[GlbPart]:
    """The parts of a model's default scene, placed by its nodes.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged or too large, or needs what is not read: animation by skins,
            compression, files beside it, lines or points.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if (size := path.stat().st_size) > MAX_BYTES:
        raise ValueError(f"{path} has {size:,} bytes, more than {MAX_BYTES:,}; {REMEDY}")
    with naming_damage(path, REMEDY):
        return _Model(path.read_bytes()).parts()


class _Model(GlbFile):
    """A file that holds a model."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        if required := self.json.get("extensionsRequired"):
            raise ValueError(f"it needs the extensions {', '.join(map(str, required))}")
        self.corners = 0
        self.pictures: dict[int, np.ndarray] = {}

    def parts(self) -> list[GlbPart]:
        """Breadth first through the nodes; a node has one parent, so none comes twice."""
        scene = self.item("scenes", self.json.get("scene", 0))
        waiting = [(index, np.eye(4)) for index in scene.get("nodes", [])]
        found: list[GlbPart] = []
        seen: set[int] = set()
        while waiting:
            index, above = waiting.pop(0)
            if index in seen:
                raise ValueError(f"node {index} stands twice in its scene")
            seen.add(index)
            node = self.item("nodes", index)
            if "skin" in node:
                raise ValueError("it is posed by a skin")
            matrix = above @ _local_matrix(node)
            waiting += [(child, matrix) for child in node.get("children", [])]
            if "mesh" in node:
                mesh = self.item("meshes", node["mesh"])
                found += [self._part(primitive, matrix) for primitive in mesh["primitives"]]
            if len(found) > MAX_PARTS:
                raise ValueError(f"it has more than {MAX_PARTS} parts")
        return found

    def _part(self, primitive: dict[str, Any], matrix: np.ndarray) -> GlbPart:
        one_of(primitive.get("mode", _TRIANGLES), (_TRIANGLES,))
        attributes = primitive["attributes"]
        local = self.values(attributes["POSITION"], ("VEC3",), (5126,)).astype(np.float64)
        vertices = local @ matrix[:3, :3].T + matrix[:3, 3]
        if not np.isfinite(vertices).all():
            raise ValueError("a position is not finite")
        if "indices" in primitive:
            order = self.values(primitive["indices"], ("SCALAR",), (5121, 5123, 5125))[:, 0]
        else:
            order = np.arange(len(vertices))
        self.corners += len(order)
        if self.corners > MAX_CORNERS:
            raise ValueError(f"it has more than {MAX_CORNERS // 3:,} triangles")
        if len(order) % 3 or (len(order) and order.max() >= len(vertices)):
            raise ValueError("its triangles name vertices that are not there")
        faces = order.astype(np.int64).reshape(-1, 3)
        if np.linalg.det(matrix[:3, :3]) < 0:
            faces = faces[:, ::-1]
        surface, channel = self._surface(primitive.get("material"))
        uvs = None
        if surface.picture is not None:
            uvs = self._uvs(attributes[f"TEXCOORD_{channel}"], len(vertices))
        return GlbPart(vertices, faces, uvs, surface)

    def _uvs(self, accessor: Any, count: int) -> np.ndarray:
        raw = self.values(accessor, ("VEC2",), (5121, 5123, 5126))
        most = 1 if raw.dtype.kind == "f" else np.iinfo(raw.dtype).max
        uvs = raw.astype(np.float64) / most
        if len(uvs) != count or not np.isfinite(uvs).all():
            raise ValueError("its texture coordinates do not fit its vertices")
        return uvs

    def _surface(self, index: Any) -> tuple[Surface, int]:
        """A part's surface, and the set of texture coordinates that it uses."""
        material = {} if index is None else self.item("materials", index)
        look = material.get("pbrMetallicRoughness", {})
        factor = np.array([number(x) for x in look.get("baseColorFactor", [1, 1, 1, 1])])
        if factor.shape != (4,) or factor.min() < 0 or factor.max() > 1:
            raise ValueError("a base colour is outside 0 to 1")
        alpha = one_of(material.get("alphaMode", "OPAQUE"), ("OPAQUE", "MASK", "BLEND"))
        picture, channel = None, 0
        if texture := look.get("baseColorTexture"):
            channel = whole_number(texture.get("texCoord", 0), 0, 7)
            source = self.item("textures", texture["index"])["source"]
            picture = self._picture(source)
        metallic, roughness = (
            min(max(number(look.get(key, 1)), 0.0), 1.0)
            for key in ("metallicFactor", "roughnessFactor")
        )
        cutoff = number(material.get("alphaCutoff", 0.5))
        return Surface(factor, picture, metallic, roughness, alpha, cutoff), channel

    def _picture(self, index: Any) -> np.ndarray:
        if index not in self.pictures:
            image = self.item("images", index)
            if "bufferView" not in image:
                raise ValueError("a picture lies outside the file")
            data, _ = self.view(image["bufferView"])
            with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as opened:
                if opened.width * opened.height > MAX_TEXELS:
                    raise ValueError(f"a picture has {opened.width} x {opened.height} texels")
                self.pictures[index] = np.asarray(opened.convert("RGBA"))
        return self.pictures[index]


def _local_matrix(node: dict[str, Any]) -> np.ndarray:
    """A node's transform, by its 16 numbers or by scale, rotation (xyzw), translation."""
    if "matrix" in node:
        columns = np.array([number(x) for x in node["matrix"]])
        return columns.reshape(4, 4).T
    matrix = np.eye(4)
    scale = [number(x) for x in node.get("scale", [1, 1, 1])]
    turn = Rotation.from_quat([number(x) for x in node.get("rotation", [0, 0, 0, 1])])
    matrix[:3, :3] = turn.as_matrix() * np.array(scale)
    matrix[:3, 3] = [number(x) for x in node.get("translation", [0, 0, 0])]
    return matrix
