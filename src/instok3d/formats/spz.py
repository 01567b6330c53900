"""Niantic's .spz files: quantised and gzipped, y up and z backward (RUB) by their specification."""

import itertools
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8

from instok3d.files import replacing
from instok3d.formats.packing import (
    check_growth,
    from_smallest_three,
    gunzip_start,
    smallest_three,
    to_unsigned,
)
from instok3d.formats.registry import ExportOptions
from instok3d.formats.splats import Splats, drawable_splats
from instok3d.formats.upright import FLIP, rigid_turn
from instok3d.geometry.moving import move_gaussians
from instok3d.reading import naming_damage
from instok3d.scene.scene import Scene

HEADER = struct.Struct("<4sIIBBBB")
"""Magic, version, count, degree, fractional bits, flags, number of streams."""
MAGIC, VERSION, EXTENSIONS = b"NGSP", 3, 2
MAX_DEGREE = 4
COLOR_SCALE = 0.15
FIXED_LIMIT = 2**23 - 1
MAX_BITS = 23
MOST_BITS = 16
"""Behind the point of coordinates that we write; fewer where they are large."""
COMPONENT_BITS = 9
REMEDY = "export it again"


def write_spz(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians in their order, turned half around x to the format's axes.

    Version 3, which all readers know. Scales are kept between 4.5e-5 and 380 scene units in steps
    of 6 %, coefficients of colour above the constant one in [-1, 1].

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
        ValueError: A coordinate is beyond 8,388,607.
    """
    gaussians = scene.gaussians.map(lambda tensor: tensor.detach().cpu())
    gaussians = move_gaussians(gaussians, rigid_turn(FLIP))
    count, means = len(gaussians.means), gaussians.means.double().numpy()
    farthest = float(np.abs(means).max(initial=0))
    if farthest > FIXED_LIMIT:
        raise ValueError(f"{path}: .spz holds coordinates within {FIXED_LIMIT}, got {farthest:.3g}")
    bits = MOST_BITS
    while farthest * 2**bits > FIXED_LIMIT:
        bits -= 1
    degree = min(options.sh_degree, int(gaussians.sh.shape[1] ** 0.5) - 1)
    sh = gaussians.sh[:, 1 : (degree + 1) ** 2].numpy()
    fixed = np.rint(means * 2**bits).astype("<i4")
    parts = [
        HEADER.pack(MAGIC, VERSION, count, degree, bits, 0, 0),
        fixed.reshape(-1, 1).view("u1")[:, :3].tobytes(),
        _bytes(to_unsigned(gaussians.opacities.numpy(), 255)),
        _bytes(to_unsigned(0.5 + COLOR_SCALE * gaussians.sh[:, 0].numpy(), 255)),
        _bytes(to_unsigned((gaussians.scales.log().numpy() + 10) * 16 / 255, 255)),
        _packed_rotations(gaussians.quats.numpy()).astype("<u4").tobytes(),
        _bytes(np.clip(np.rint(128 + 128 * sh), 0, 255)),
    ]
    packer = zlib.compressobj(9, zlib.DEFLATED, zlib.MAX_WBITS | 16)
    with replacing(path, overwrite=options.overwrite) as part:
        part.write_bytes(packer.compress(b"".join(parts)) + packer.flush())


def read_spz(path: Path) -> Splats:
    """The Gaussians of an .spz file of version 2 to 4, in OpenCV axes.

    The sizes that its header promises are compared with the file's before it is inflated. Colours
    above degree 3 are left out.

    Raises:
        FileNotFoundError: No such file.
        ModuleNotFoundError: It is of version 4, and zstandard is not installed.
        ValueError: It is damaged, or of another version.
    """
    data = path.read_bytes()
    with naming_damage(path, REMEDY):
        if data[:4] == MAGIC:
            return _read_streams(path, data)
        header = _Header.of(gunzip_start(data, HEADER.size), versions=(2, 3))
        if header.flags & EXTENSIONS:
            raise ValueError("it has extensions, which are not read")
        promised = HEADER.size + header.count * sum(header.widths)
        check_growth(path, promised)
        inflated = gunzip_start(data, promised + 1)
        if len(inflated) != promised:
            more = "more" if len(inflated) > promised else len(inflated)
            raise ValueError(f"its header promises {promised} bytes, {more} are there")
        ends = np.cumsum([HEADER.size, *(header.count * width for width in header.widths)])
        streams = [inflated[a:b] for a, b in itertools.pairwise(ends.tolist())]
        return _unpacked(path, header, streams, ())


@dataclass(frozen=True)
class _Header:
    """What the first bytes of all versions say."""

    version: int
    count: int
    degree: int
    bits: int
    """Behind the point of coordinates."""
    flags: int
    num_streams: int
    """Of version 4; 0 before it."""

    @staticmethod
    def of(data: bytes, versions: tuple[int, ...]) -> "_Header":
        magic, *fields = HEADER.unpack(data[: HEADER.size])
        header = _Header(*fields)
        if magic != MAGIC or header.version not in versions or header.degree > MAX_DEGREE:
            raise ValueError(
                f"wanted {MAGIC} of version {versions} and degree 0 to {MAX_DEGREE}, found "
                f"{magic} of version {header.version} and degree {header.degree}"
            )
        if header.bits > MAX_BITS:
            raise ValueError(f"coordinates have {header.bits} bits behind the point, of 23")
        return header

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes a Gaussian of positions, alphas, colours, scales, rotations, other colours."""
        rotation = 3 if self.version == 2 else 4
        return (9, 1, 3, 3, rotation, 3 * ((self.degree + 1) ** 2 - 1))


def _read_streams(path: Path, data: bytes) -> Splats:
    """A file of version 4: each attribute compressed by zstandard, behind a table of sizes."""
    header = _Header.of(data, versions=(4,))
    (table,) = struct.unpack_from("<I", data, HEADER.size)
    widths = [width for width in header.widths if width]
    if header.num_streams != len(widths):
        raise ValueError(f"it has {header.num_streams} streams; wanted {len(widths)}")
    sizes = [struct.unpack_from("<QQ", data, table + 16 * i) for i in range(len(widths))]
    if [inflated for _, inflated in sizes] != [header.count * width for width in widths]:
        raise ValueError(f"its streams are not those of {header.count} Gaussians")
    check_growth(path, header.count * sum(widths))
    streams, start = [], table + 16 * len(widths)
    for packed, inflated in sizes:
        if start + packed > len(data):
            raise ValueError("it is cut short")
        streams.append(_unzstd(data[start : start + packed], inflated))
        start += packed
    streams += [b""] * (len(header.widths) - len(widths))
    left_out = f"{path}: its extensions were left out; they may change its colours"
    return _unpacked(path, header, streams, (left_out,) if header.flags & EXTENSIONS else ())


def _unzstd(data: bytes, length: int) -> bytes:
    try:
        import zstandard
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "spz of version 4 needs zstandard: pip install 'instok3d[formats]', or write version 3"
        ) from error
    try:
        with zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(data) as stream:
            inflated = stream.read(length + 1)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error
    if len(inflated) != length:
        raise ValueError(f"a stream has another length than {length}")
    return inflated


def _unpacked(path: Path, header: _Header, streams: list[bytes], notes: tuple[str, ...]) -> Splats:
    """The Gaussians of the inflated streams."""
    places, alphas, colors, scales, rotations, rest = (
        np.frombuffer(stream, np.uint8).reshape(header.count, width)
        for stream, width in zip(streams, header.widths, strict=True)
    )
    fixed = np.zeros((header.count, 3, 4), np.uint8)
    fixed[:, :, 1:] = places.reshape(-1, 3, 3)  # the upper three bytes: the sign comes along
    means = (fixed.view("<i4")[:, :, 0] >> 8) / np.float32(2**header.bits)
    if header.degree > 3:
        notes = (*notes, f"{path}: colours of degree {header.degree} were cut to degree 3")
    kept = min(header.degree, 3)
    sh = np.empty((len(places), (kept + 1) ** 2, 3), np.float32)
    sh[:, 0] = (colors / np.float32(255) - np.float32(0.5)) / np.float32(COLOR_SCALE)
    above = rest.reshape(len(rest), rest.shape[1] // 3, 3)[:, : sh.shape[1] - 1]
    sh[:, 1:] = (above - np.float32(128)) / 128
    splats = drawable_splats(
        path,
        means=torch.from_numpy(means.astype(np.float32)),
        quats=torch.from_numpy(_unpacked_rotations(rotations)),
        scales=torch.from_numpy(np.exp(scales / np.float32(16) - 10)),
        opacities=torch.from_numpy(alphas[:, 0] / np.float32(255)),
        sh=torch.from_numpy(sh),
        notes=notes,
    )
    return splats.moved(rigid_turn(FLIP))


def _packed_rotations(quats: Float[np.ndarray, "row 4"]) -> Int[np.ndarray, " row"]:
    """Two bits for the largest of x, y, z, w, then sign and nine bits for each of the others."""
    largest, three = smallest_three(quats[:, [1, 2, 3, 0]])
    sizes = to_unsigned(np.abs(three) * 2**0.5, 2**COMPONENT_BITS - 1)
    packed = largest.astype(np.int64)
    for column in range(3):
        negative = (three[:, column] < 0).astype(np.int64)
        packed = packed << 10 | negative << COMPONENT_BITS | sizes[:, column]
    return packed


def _unpacked_rotations(table: UInt8[np.ndarray, "row width"]) -> Float[np.ndarray, "row 4"]:
    """Quaternions wxyz of version 3 (four bytes) or 2 (x, y, z in a byte each, w >= 0)."""
    if table.shape[1] == 3:
        xyz = table / np.float32(127.5) - 1
        w = np.sqrt(np.maximum(0, 1 - np.square(xyz).sum(axis=1)))
        return np.concatenate([w[:, None], xyz], axis=1).astype(np.float32)
    packed = np.ascontiguousarray(table).view("<u4")[:, 0].astype(np.int64)
    fields = np.stack([packed >> 20, packed >> 10, packed], axis=1)
    sizes = (fields & (2**COMPONENT_BITS - 1)) / ((2**COMPONENT_BITS - 1) * 2**0.5)
    three = np.where(fields >> COMPONENT_BITS & 1, -sizes, sizes)
    return from_smallest_three(packed >> 30, three)[:, [3, 0, 1, 2]]


def _bytes(values: np.ndarray) -> bytes:
    return values.astype(np.uint8).tobytes()
