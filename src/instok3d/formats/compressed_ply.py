"""PlayCanvas's .compressed.ply: 16 bytes for each Gaussian, by the bounds of 256 neighbours."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from instok3d.files import replacing
from instok3d.formats.packing import from_smallest_three, smallest_three, to_unsigned
from instok3d.formats.ply_tables import PlyHeader, read_header, read_table
from instok3d.formats.registry import ExportOptions
from instok3d.formats.splats import Splats, drawable_splats
from instok3d.formats.statements import scene_comments, stated_units, stated_up
from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.scene.scene import Scene

CHUNK = 256
BOUNDS = [f"{end}_{name}" for group in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"),
          ("r", "g", "b")) for end in ("min", "max") for name in group]  # fmt: skip
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
LOG_SCALES = (-20.0, 20.0)
SH_RANGE = 8.0
"""Coefficients above the constant one lie within half of it; in 256 steps."""


def write_compressed_ply(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians, sorted by object and along a space-filling curve within each.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
    """
    gaussians = scene.gaussians.map(lambda tensor: tensor.detach().cpu())
    order = np.lexsort((_morton(gaussians.means.double().numpy()), _object_ranks(scene)))
    gaussians = gaussians.rows(torch.from_numpy(order))
    count, chunks = len(order), -(-len(order) // CHUNK)
    values = np.concatenate(
        [
            gaussians.means.numpy(),
            np.clip(gaussians.scales.log().numpy(), *LOG_SCALES),
            0.5 + SH_CONSTANT * gaussians.sh[:, 0].numpy(),
        ],
        axis=1,
    ).astype(np.float32)
    padded = np.concatenate([values, values[-1:].repeat(chunks * CHUNK - count, axis=0)])
    padded = padded.reshape(chunks, CHUNK, 9)
    low, high = padded.min(axis=1, initial=np.inf), padded.max(axis=1, initial=-np.inf)
    span = np.where(high > low, high - low, 1)
    shares = ((padded - low[:, None]) / span[:, None]).reshape(-1, 9)[:count]
    bounds = np.stack([low.reshape(-1, 3, 3), high.reshape(-1, 3, 3)], axis=2)
    packed = np.stack(
        [
            _pack_11_10_11(shares[:, :3]),
            _pack_rotations(gaussians.quats.numpy()),
            _pack_11_10_11(shares[:, 3:6]),
            _pack_colors(shares[:, 6:], gaussians.opacities.numpy()),
        ],
        axis=1,
    )
    degree = min(options.sh_degree, int(gaussians.sh.shape[1] ** 0.5) - 1)
    rest = gaussians.sh[:, 1 : (degree + 1) ** 2].mT.flatten(1).numpy()
    steps = np.clip(np.floor((rest / SH_RANGE + 0.5) * 256), 0, 255).astype(np.uint8)
    header = ["ply", "format binary_little_endian 1.0",
              *(f"comment {line}" for line in scene_comments(scene)),
              f"element chunk {chunks}", *(f"property float {name}" for name in BOUNDS),
              f"element vertex {count}", *(f"property uint {name}" for name in PACKED)]  # fmt: skip
    if degree:
        header += [f"element sh {count}"]
        header += [f"property uchar f_rest_{i}" for i in range(steps.shape[1])]
    with replacing(path, overwrite=options.overwrite) as part, part.open("wb") as stream:
        stream.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii", "replace"))
        stream.write(bounds.astype("<f4").tobytes())
        stream.write(packed.astype("<u4").tobytes())
        stream.write(steps.tobytes())


def read_compressed_ply(path: Path) -> Splats:
    """The Gaussians of a compressed PLY; see `read_compressed`."""
    return read_compressed(path, read_header(path))


def read_compressed(path: Path, header: PlyHeader) -> Splats:
    """The Gaussians of a compressed PLY whose header was read.

    Raises:
        ValueError: Columns or chunks are missing.
    """
    chunk, vertex, rest = (header.element(name) for name in ("chunk", "vertex", "sh"))
    if chunk is None or vertex is None or not {*BOUNDS[:12]} <= {*chunk.names}:
        raise ValueError(f"{path} is no compressed PLY: the bounds of its chunks are missing")
    if not {*PACKED} <= {*vertex.names} or chunk.count < -(-vertex.count // CHUNK):
        raise ValueError(f"{path} is no compressed PLY: packed columns or chunks are missing")
    if any(each is not None and len(each.names) == 0 for each in (chunk, vertex, rest)):
        raise ValueError(f"{path} is no compressed PLY: an element has no columns")
    rows, bounds = read_table(path, header, vertex), read_table(path, header, chunk)
    packed = [rows[name].astype(np.int64) & 0xFFFFFFFF for name in PACKED]
    with np.errstate(all="ignore"):  # of bounds that are not finite; those rows are dropped
        means = _within(bounds, BOUNDS[0:3], BOUNDS[3:6], _unpack_11_10_11(packed[0]))
        scales = np.exp(_within(bounds, BOUNDS[6:9], BOUNDS[9:12], _unpack_11_10_11(packed[2])))
        colors = np.stack([packed[3] >> shift & 255 for shift in (24, 16, 8)], axis=1) / 255.0
        if {*BOUNDS[12:]} <= {*chunk.names}:
            colors = _within(bounds, BOUNDS[12:15], BOUNDS[15:18], colors)
    sh = np.zeros((len(rows), 1, 3), np.float32)
    sh[:, 0] = (colors - 0.5) / SH_CONSTANT
    if rest is not None:
        sh = np.concatenate([sh, _rest(path, header, len(rows))], axis=1)
    fields = np.stack([packed[1] >> shift & 1023 for shift in (20, 10, 0)], axis=1)
    return drawable_splats(
        path,
        means=torch.from_numpy(means),
        quats=torch.from_numpy(
            from_smallest_three(packed[1] >> 30, (fields / 1023 - 0.5) * 2**0.5)
        ),
        scales=torch.from_numpy(scales),
        opacities=torch.from_numpy(((packed[3] & 255) / 255.0).astype(np.float32)),
        sh=torch.from_numpy(sh),
        up=stated_up(header.comments),
        units=stated_units(header.comments),
    )


def _rest(path: Path, header: PlyHeader, count: int) -> Float[np.ndarray, "row coefficient 3"]:
    """Coefficients above the constant one, from bytes, channel by channel."""
    element = header.element("sh")
    assert element is not None
    names = [f"f_rest_{i}" for i in range(len(element.names))]
    if len(names) not in (9, 24, 45) or {*names} != {*element.names} or element.count != count:
        raise ValueError(f"{path}: its element 'sh' is none of 9, 24 or 45 columns f_rest_*")
    rows = read_table(path, header, element)
    steps = np.stack([np.asarray(rows[name], np.float32) for name in names], axis=1)
    # The ends of the range are exact, so that what is clamped stays so.
    shares = np.where(steps <= 0, 0, np.where(steps >= 255, 1, (steps + 0.5) / 256))
    values = ((shares - 0.5) * SH_RANGE).reshape(count, 3, len(names) // 3).swapaxes(1, 2)
    return np.ascontiguousarray(values, np.float32)


def _within(
    bounds: np.ndarray, low: list[str], high: list[str], shares: Float[np.ndarray, "row 3"]
) -> Float[np.ndarray, "row 3"]:
    """Values at shares of the way between the bounds of each row's chunk."""
    values = np.empty(shares.shape, np.float32)
    for column, (first, last) in enumerate(zip(low, high, strict=True)):
        start = bounds[first].astype(np.float64).repeat(CHUNK)[: len(shares)]
        end = bounds[last].astype(np.float64).repeat(CHUNK)[: len(shares)]
        values[:, column] = start * (1 - shares[:, column]) + end * shares[:, column]
    return values


def _pack_11_10_11(shares: Float[np.ndarray, "row 3"]) -> Int[np.ndarray, " row"]:
    x, y, z = (to_unsigned(shares[:, i], most) for i, most in enumerate((2047, 1023, 2047)))
    return x << 21 | y << 11 | z


def _unpack_11_10_11(packed: Int[np.ndarray, " row"]) -> Float[np.ndarray, "row 3"]:
    fields = [(packed >> 21) / 2047, (packed >> 11 & 1023) / 1023, (packed & 2047) / 2047]
    return np.stack(fields, axis=1)


def _pack_rotations(quats: Float[np.ndarray, "row 4"]) -> Int[np.ndarray, " row"]:
    largest, three = smallest_three(quats)
    fields = to_unsigned(three / 2**0.5 + 0.5, 1023)
    return largest << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]


def _pack_colors(
    colors: Float[np.ndarray, "row 3"], opacities: Float[np.ndarray, " row"]
) -> Int[np.ndarray, " row"]:
    red, green, blue = to_unsigned(colors, 255).T
    return red << 24 | green << 16 | blue << 8 | to_unsigned(opacities, 255)


def _object_ranks(scene: Scene) -> Int[np.ndarray, " gaussian"]:
    """The place of each Gaussian's object among the scene's; the rest comes last."""
    ranks = np.full(len(scene.gaussians.means), len(scene.objects), np.int64)
    for rank, item in enumerate(scene.objects):
        start, count = item.gaussian_range
        ranks[start : start + count] = rank
    return ranks


def _morton(points: Float[np.ndarray, "row 3"]) -> Int[np.ndarray, " row"]:
    """Where points lie on a Z-order curve through their bounds, in 1024 steps a side."""
    if not len(points):
        return np.zeros(0, np.int64)
    low, high = points.min(axis=0), points.max(axis=0)
    steps = to_unsigned((points - low) / np.maximum(high - low, 1e-12), 1023)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (steps[:, axis] >> bit & 1) << (3 * bit + axis)
    return code
