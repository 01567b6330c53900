"""The .ksplat files of GaussianSplats3D: sections of rows, raw or as halves within buckets."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from instok3d.files import replacing
from instok3d.formats.packing import to_unsigned
from instok3d.formats.registry import ExportOptions
from instok3d.formats.splats import Splats, drawable_splats
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.reading import naming_damage
from instok3d.scene.scene import Scene

FILE_HEADER, SECTION_HEADER = 4096, 1024
FILE = np.dtype({
    "names": ["major", "minor", "max_sections", "sections", "max_count", "count", "mode",
              "center", "least_sh", "most_sh"],
    "formats": ["u1", "u1", "<u4", "<u4", "<u4", "<u4", "<u2", ("<f4", 3), "<f4", "<f4"],
    "offsets": [0, 1, 4, 8, 12, 16, 20, 24, 36, 40], "itemsize": FILE_HEADER,
})  # fmt: skip
SECTION = np.dtype({
    "names": ["count", "max_count", "bucket_size", "buckets", "block_size", "bucket_bytes",
              "range", "full", "partial", "degree"],
    "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
    "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40], "itemsize": SECTION_HEADER,
})  # fmt: skip
MAX_DEGREE = 2
SH_LIMIT = 1.5
"""Of coefficients in one byte, where the file states none."""
HALF_RANGE = 32767
REMEDY = "export it again"


def write_ksplat(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians in their order and axes, uncompressed, of degree 2 at most.

    Constant colour and opacity have a byte each.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
    """
    gaussians = scene.gaussians.map(lambda tensor: tensor.detach().cpu())
    degree = min(options.sh_degree, MAX_DEGREE, int(gaussians.sh.shape[1] ** 0.5) - 1)
    count = len(gaussians.means)
    rows = np.zeros(count, _row(0, degree))
    rows["means"], rows["scales"] = gaussians.means.numpy(), gaussians.scales.numpy()
    rows["quats"] = gaussians.quats.numpy()
    rows["rgba"][:, :3] = to_unsigned(0.5 + SH_CONSTANT * gaussians.sh[:, 0].numpy(), 255)
    rows["rgba"][:, 3] = to_unsigned(gaussians.opacities.numpy(), 255)
    for band in range(1, degree + 1):
        own = gaussians.sh[:, band**2 : (band + 1) ** 2]
        rows[f"band{band}"] = own.mT.flatten(1).numpy()
    header, section = np.zeros(1, FILE), np.zeros(1, SECTION)
    header["minor"], header["max_sections"], header["sections"] = 1, 1, 1
    header["max_count"] = header["count"] = count
    header["least_sh"], header["most_sh"] = -SH_LIMIT, SH_LIMIT
    section["count"] = section["max_count"] = count
    section["block_size"], section["range"], section["degree"] = 1.0, 1, degree
    with replacing(path, overwrite=options.overwrite) as part:
        part.write_bytes(header.tobytes() + section.tobytes() + rows.tobytes())


def read_ksplat(path: Path) -> Splats:
    """The Gaussians of a .ksplat file of compression level 0, 1 or 2.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is damaged, or of another version.
    """
    data = path.read_bytes()
    with naming_damage(path, REMEDY), np.errstate(all="ignore"):
        file = np.frombuffer(data, FILE, 1)[0]
        if file["major"] != 0 or file["minor"] < 1 or file["mode"] > 2:
            raise ValueError(
                f"wanted version 0.1 and level 0 to 2, found {file['major']}.{file['minor']} and "
                f"{file['mode']}"
            )
        sections = np.frombuffer(data, SECTION, int(file["max_sections"]), FILE_HEADER)
        degree = int(sections["degree"].max(initial=0))
        if degree > 3:
            raise ValueError(f"a section has colours of degree {degree}")
        start, parts = FILE_HEADER + sections.nbytes, []
        for section in sections:
            part, start = _read_section(data, start, section, file, (degree + 1) ** 2)
            parts.append(part)
        found = sum(len(part.means) for part in parts)
        if found != file["count"]:
            raise ValueError(f"it promises {file['count']} Gaussians, its sections have {found}")
        if not parts:
            raise ValueError("it has no sections")
    means, quats, scales, opacities, sh = (
        torch.from_numpy(np.concatenate([getattr(part, name) for part in parts]))
        for name in ("means", "quats", "scales", "opacities", "sh")
    )
    return drawable_splats(
        path, means=means, quats=quats, scales=scales, opacities=opacities, sh=sh
    )


@dataclass(frozen=True)
class _Part:
    """The Gaussians of one section, decoded."""

    means: Float[np.ndarray, "row 3"]
    quats: Float[np.ndarray, "row 4"]
    scales: Float[np.ndarray, "row 3"]
    opacities: Float[np.ndarray, " row"]
    sh: Float[np.ndarray, "row coefficient 3"]


def _row(mode: int, degree: int) -> np.dtype:
    """One Gaussian at a compression level; scales are linear, quaternions wxyz."""
    place, number = ("<f4", "<f4") if mode == 0 else ("<u2", "<f2")
    color = ("<f4", "<f2", "u1")[mode]
    bands = [(f"band{band}", color, (3 * (2 * band + 1),)) for band in range(1, degree + 1)]
    return np.dtype([("means", place, (3,)), ("scales", number, (3,)), ("quats", number, (4,)),
                     ("rgba", "u1", (4,)), *bands])  # fmt: skip


def _read_section(
    data: bytes, start: int, section: np.void, file: np.void, coefficients: int
) -> tuple[_Part, int]:
    """The Gaussians of a section that begins at `start`, and where it ends.

    Colours are filled up with zeros to a number of coefficients.
    """
    count, room = int(section["count"]), int(section["max_count"])
    buckets, partial = int(section["buckets"]), int(section["partial"])
    degree = int(section["degree"])
    if count > room:
        raise ValueError(f"a section has {count} of {room} Gaussians")
    row = _row(int(file["mode"]), degree)
    body = start + 4 * partial + int(section["bucket_bytes"]) * buckets
    end = body + room * row.itemsize
    if end > len(data):
        raise ValueError(f"its sections promise {end} bytes, {len(data)} are there")
    rows = np.frombuffer(data, row, count, body)
    means = rows["means"].astype(np.float32)
    if file["mode"] != 0:
        sizes = np.frombuffer(data, "<u4", partial, start)
        centers = np.frombuffer(data, "<f4", 3 * buckets, start + 4 * partial).reshape(-1, 3)
        reach = int(section["range"]) or HALF_RANGE
        means = (means - reach) * (float(section["block_size"]) / 2 / reach)
        means = (means + centers[_bucket_of(count, section, sizes)]).astype(np.float32)
    sh = np.zeros((count, coefficients, 3), np.float32)
    sh[:, 0] = (rows["rgba"][:, :3] / np.float32(255) - np.float32(0.5)) / np.float32(SH_CONSTANT)
    for band in range(1, degree + 1):
        values = rows[f"band{band}"].astype(np.float32)
        if file["mode"] == 2:
            low, high = (float(file["least_sh"]) or -SH_LIMIT, float(file["most_sh"]) or SH_LIMIT)
            values = low + values / 255 * (high - low)
        sh[:, band**2 : (band + 1) ** 2] = values.reshape(count, 3, 2 * band + 1).swapaxes(1, 2)
    quats, scales = rows["quats"].astype(np.float32), rows["scales"].astype(np.float32)
    return _Part(means, quats, scales, rows["rgba"][:, 3] / np.float32(255), sh), end


def _bucket_of(count: int, section: np.void, sizes: np.ndarray) -> np.ndarray:
    """Which bucket each row lies in: full ones first, then those of the sizes."""
    full = int(section["full"])
    in_full = min(count, full * int(section["bucket_size"]))
    size = max(1, int(section["bucket_size"]))
    first = np.arange(in_full) // size
    ends = np.cumsum(sizes.astype(np.int64))
    later = full + np.searchsorted(ends, np.arange(count - in_full), side="right")
    return np.concatenate([first, later])
