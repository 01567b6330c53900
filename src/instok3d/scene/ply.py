"""Gaussians as the PLY files of 3D Gaussian Splatting, which every splat viewer opens."""

import math
import warnings
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int, Num
from torch import Tensor

from instok3d.files import replacing
from instok3d.scene.edits.disclosure import edited_words
from instok3d.scene.scene import Scene
from instok3d.types import MAX_LENGTH, Gaussians

HEADER_LIMIT_BYTES = 128 * 1024
OPACITY_LIMIT = 1e-6
"""Opacities are written this far from 0 and 1, where the logit is infinite."""
LOGIT_LIMIT = 80.0
"""Infinite logits are read as this one, which single precision cannot tell from 0 or 1 either."""
SCALES = (torch.finfo(torch.float32).tiny, MAX_LENGTH)
"""What scales are kept within. Others write flat Gaussians with scale 0, whose logarithm is
infinite."""

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2",
    "ushort": "<u2", "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4",
    "uint32": "<u4", "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip
NEEDED = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
          "rot_0", "rot_1", "rot_2", "rot_3"]  # fmt: skip


def write_ply(
    path: Path,
    gaussians: Gaussians,
    *,
    sh_degree: int = 3,
    object_ids: Int[Tensor, " gaussian"] | None = None,
    comments: tuple[str, ...] = (),
    overwrite: bool = True,
) -> None:
    """Write unbatched Gaussians in their order, atomically.

    Log scales, logit opacities, quaternions wxyz, colour as f_dc and channel-major f_rest, in
    OpenCV axes as they are. Bands that the Gaussians lack are zeros: many readers know only
    degree 0 and 3. Bands above `sh_degree` are left out.

    Args:
        path: Where to; its folder must exist.
        gaussians: Unbatched.
        sh_degree: Degree of the file, 0 to 3.
        object_ids: Written as one more float column `object_id`; readers with a fixed layout
            refuse such files.
        comments: Lines for the header.
        overwrite: Replace a file that is there.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
        ValueError: sh_degree is not in 0..3 or a comment holds a line break.
    """
    if sh_degree not in (0, 1, 2, 3):
        raise ValueError(f"sh_degree must be 0, 1, 2 or 3, got {sh_degree}")
    if any("\n" in line or "\r" in line for line in comments):
        raise ValueError("a PLY comment must be one line")
    columns = _columns(gaussians, sh_degree)
    if object_ids is not None:
        columns["object_id"] = object_ids.cpu().numpy()
    count = gaussians.means.shape[0]
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    header += [f"element vertex {count}", *(f"property float {name}" for name in columns)]
    rows = np.stack([np.asarray(column, "<f4") for column in columns.values()], axis=1)
    with replacing(path, overwrite=overwrite) as part, part.open("wb") as stream:
        stream.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii", "replace"))
        stream.write(np.ascontiguousarray(rows).tobytes())


def read_ply(path: Path) -> Gaussians:
    """Unbatched Gaussians of a 3DGS PLY file, on the CPU in float32; anchor_index is all 0.

    The header is checked against the file's size before anything is allocated. An infinite logit
    is full or no opacity, a scale of 0 becomes a tiny one. Rows that cannot be drawn are dropped
    with a warning: numbers that are not finite, quaternions of length 0.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not a binary little-endian PLY of Gaussians, or its size is wrong.
    """
    with path.open("rb") as stream:
        head = stream.read(HEADER_LIMIT_BYTES)
    count, layout, offset = _parse_header(path, head)
    have = path.stat().st_size
    want = offset + count * layout.itemsize
    if have != want:
        raise ValueError(
            f"{path}: the header promises {count} Gaussians in {want} bytes but the file has "
            f"{have}; it is cut short or damaged"
        )
    rows = np.fromfile(path, dtype=layout, count=count, offset=offset)
    return _gaussians(path, rows)


def scene_comments(scene: Scene) -> tuple[str, ...]:
    """What the header of a scene's PLY says of its frame and units.

    The vertical axis is left out where it is not known well enough.
    """
    vertical, world = scene.vertical, f"instok3d world: {scene.frame}"
    up = " ".join(f"{value:.4g}" for value in vertical.up)
    if scene.frame == "first camera":
        world += ", OpenCV axes (x right, y down, z forward)"
    elif vertical.is_stated:
        world += f", their axes; up estimated, confidence {vertical.confidence:.2f}"
    else:
        world += ", their axes; up unknown"
    return (
        "SplatRenderMode: default",
        *([f"Vertical axis: {up}"] if vertical.is_stated else []),
        f"instok3d generator: {scene.provenance.generator}",
        world,
        f"instok3d units: {scene.units}",
        *([f"instok3d {edited_words(scene)}"] if scene.provenance.edits else []),
        "instok3d order: sorted by object; rows of each object in objects.json, gaussian_range",
    )


def _columns(gaussians: Gaussians, sh_degree: int) -> dict[str, Num[np.ndarray, " gaussian"]]:
    """Column name -> values, in the order of the reference implementation."""
    means, sh = gaussians.means.detach().cpu().numpy(), gaussians.sh.detach().cpu()
    rest = sh.new_zeros(sh.shape[0], 15, 3)
    rest[:, : sh.shape[1] - 1] = sh[:, 1:]
    count = (sh_degree + 1) ** 2 - 1
    # Channel-major: all coefficients of red, then green, then blue.
    rest = rest[:, :count].mT.reshape(sh.shape[0], 3 * count).numpy()
    opacities = gaussians.opacities.detach().cpu().double()
    logits = opacities.clamp(OPACITY_LIMIT, 1 - OPACITY_LIMIT).logit().numpy()
    log_scales = gaussians.scales.detach().cpu().clamp(*SCALES).log().numpy()
    quats = gaussians.quats.detach().cpu().numpy()
    normals = np.zeros(len(means))
    columns = {name: means[:, i] for i, name in enumerate("xyz")}
    columns |= dict.fromkeys(("nx", "ny", "nz"), normals)
    columns |= {f"f_dc_{i}": sh[:, 0, i].numpy() for i in range(3)}
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(3 * count)}
    columns |= {"opacity": logits}
    columns |= {f"scale_{i}": log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": quats[:, i] for i in range(4)}
    return columns


def _parse_header(path: Path, head: bytes) -> tuple[int, np.dtype, int]:
    """Number of rows, their layout, and where they begin."""
    end = head.find(b"end_header")
    after = head[end + 10 : end + 12]
    newline = 2 if after == b"\r\n" else 1
    if not head.startswith(b"ply") or end < 0 or after[:1] not in (b"\n", b"\r"):
        raise ValueError(f"{path} is not a PLY file: no header found in its first bytes")
    lines = [line.split() for line in head[:end].decode("ascii", "replace").splitlines()[1:]]
    lines = [line for line in lines if line and line[0] not in ("comment", "obj_info")]
    if not lines or lines[0] != ["format", "binary_little_endian", "1.0"]:
        found = " ".join(lines[0])[:100] if lines else "nothing"
        raise ValueError(f"{path}: wanted format binary_little_endian 1.0, found {found}")
    count = _count(path, [line for line in lines if line[0] == "element"])
    layout = []
    for line in lines:
        if line[0] == "property":
            if len(line) != 3 or line[1] not in TYPES:
                raise ValueError(f"{path}: cannot read the property '{' '.join(line)[:100]}'")
            layout.append((line[2], TYPES[line[1]]))
    names = [name for name, _ in layout]
    num_rest = sum(name.startswith("f_rest_") for name in names)
    if num_rest not in (0, 9, 24, 45):
        raise ValueError(f"{path}: {num_rest} columns f_rest_*; wanted 0, 9, 24 or 45")
    wanted = [*NEEDED, *(f"f_rest_{i}" for i in range(num_rest))]
    missing = [name for name in wanted if name not in names]
    if missing or len(set(names)) != len(names):
        raise ValueError(f"{path} holds no Gaussians: missing or doubled columns {missing}")
    return count, np.dtype(layout), end + 10 + newline


def _count(path: Path, elements: list[list[str]]) -> int:
    """Number of Gaussians, by the lines of the header that say what the file consists of."""
    if len(elements) == 1 and elements[0][1:2] == ["vertex"] and len(elements[0]) == 3:
        digits = elements[0][2]
        if digits.isdecimal() and len(digits) < 19:
            return int(digits)
    found = ", ".join(" ".join(line[1:])[:100] for line in elements[:10])
    raise ValueError(
        f"{path}: wanted one element 'vertex' with one row a Gaussian, found: {found}; "
        "compressed PLYs and meshes are not read"
    )


def _gaussians(path: Path, rows: np.ndarray) -> Gaussians:
    """The rows as Gaussians, without those that cannot be drawn."""
    names = rows.dtype.names or ()
    num_rest = sum(name.startswith("f_rest_") for name in names)
    columns = [*NEEDED, *(f"f_rest_{i}" for i in range(num_rest))]
    with np.errstate(over="ignore"):  # of double columns; those rows are dropped
        values = np.stack([rows[name].astype(np.float32) for name in columns], axis=1)
    table = torch.from_numpy(values)
    table[:, 6] = table[:, 6].clamp(-LOGIT_LIMIT, LOGIT_LIMIT)
    table[:, 7:10] = table[:, 7:10].clamp_min(math.log(SCALES[0]))
    drawable = table.isfinite().all(dim=1) & (table[:, :3].abs() <= MAX_LENGTH).all(dim=1)
    # Longest entry first: squares of small ones vanish, and those of large ones overflow.
    longest = table[:, 10:14].abs().amax(dim=1)
    drawable &= longest > 0
    if not drawable.all():
        count = int((~drawable).sum())
        warnings.warn(
            f"{path}: dropped {count} Gaussians that cannot be drawn: with numbers that are not "
            "finite, or a quaternion of length 0",
            stacklevel=3,
        )
    table, longest = table[drawable], longest[drawable]
    count = len(table)
    rest = table[:, 14:].reshape(count, 3, num_rest // 3).mT
    return Gaussians(
        means=table[:, :3].contiguous(),
        quats=torch.nn.functional.normalize(table[:, 10:14] / longest[:, None], dim=1),
        scales=table[:, 7:10].exp().clamp(*SCALES),
        opacities=table[:, 6].sigmoid(),
        sh=torch.cat([table[:, None, 3:6], rest], dim=1).contiguous(),
        anchor_index=torch.zeros(count, dtype=torch.long),
    )
