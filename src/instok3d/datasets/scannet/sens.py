"""The .sens files of ScanNet, version 4: JPEG colour, zlib depth and a pose for each frame.

Little-endian: header (name, 4x4 intrinsics and extrinsics of colour and depth, compressions,
sizes, depth shift, number of frames), then for each frame its camera-to-world matrix, two time
stamps, two sizes and the compressed bytes. What follows the frames (IMU data) is not read.
"""

import io
import math
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float, UInt8, UInt16
from PIL import Image

from instok3d.files import replacing
from instok3d.photos.image_decoding import naming_damage

VERSION = 4
JPEG, ZLIB_U16 = 2, 1
_MATRICES = struct.Struct("<64f")
_KINDS_AND_SIZES = struct.Struct("<iiIIIIfQ")
_FRAME = struct.Struct("<16fQQQQ")
FRAME_HEAD_BYTES = _FRAME.size
"""Before the picture and depth of each frame."""
_LONGEST_NAME = 4096
_MOST_PIXELS = 2**26
_SHIFTS = (1e-3, 1e9)
"""Stored depths in one metre that can be; ScanNet has 1000."""


@dataclass(frozen=True)
class SensFrame:
    """Where one frame lies in the file; nothing is decoded yet."""

    world_from_cam: Float[np.ndarray, "4 4"]
    """Metres; not finite where tracking was lost."""
    color_start: int
    color_bytes: int
    depth_start: int
    depth_bytes: int


class SensFile:
    """One scan, read frame by frame; use it in a `with` block.

    A file that ends early is refused as a whole: its download is incomplete, and a scan of fewer
    frames would silently change what is trained on.

    Args:
        path: The .sens file.
        num_frames: Index only so many frames from the start; None for all.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is not version 4 with JPEG colour and zlib depth, or ends early; the
            message names the frame and the byte.
    """

    color_size: tuple[int, int]
    """Height, width."""
    depth_size: tuple[int, int]
    intrinsics: Float[np.ndarray, "3 3"]
    """Of the depth camera in pixels of depth_size, the centre of the first pixel at (0.5, 0.5)
    (the file counts from that centre)."""
    depth_shift: float
    """Stored depths in one metre."""
    frame_count: int
    """Of the whole file, by its header."""

    def __init__(self, path: Path, num_frames: int | None = None) -> None:
        if not path.is_file():
            raise FileNotFoundError(f"there is no scan {path}")
        self.path = path
        self._size = path.stat().st_size
        self._stream = path.open("rb")
        try:
            self._read_header()
            wanted = self.frame_count if num_frames is None else min(num_frames, self.frame_count)
            self.frames = tuple(self._index(wanted))
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> "SensFile":
        return self

    def __exit__(self, *error: object) -> None:
        self._stream.close()

    def image(self, number: int) -> Image.Image:
        """The colour picture of a frame, sRGB.

        Raises:
            ValueError: Its JPEG is damaged or has another size than the header says.
        """
        frame = self.frames[number]
        data = self._bytes(frame.color_start, frame.color_bytes, f"frame {number}")
        what = f"{self.path}: the JPEG of frame {number} (byte {frame.color_start})"
        with naming_damage(what):
            image = Image.open(io.BytesIO(data), formats=["JPEG"])
        if (image.height, image.width) != self.color_size:
            raise ValueError(
                f"{self.path}: the JPEG of frame {number} has {image.height} x {image.width} "
                f"pixels, the header says {self.color_size[0]} x {self.color_size[1]}; download "
                "it again"
            )
        with naming_damage(what):
            return image.convert("RGB")

    def depth_mm(self, number: int) -> UInt16[np.ndarray, "height width"]:
        """z-depth of a frame in millimetres, 0 = unknown.

        Raises:
            ValueError: It cannot be decompressed or has another size than the header says.
        """
        frame = self.frames[number]
        data = self._bytes(frame.depth_start, frame.depth_bytes, f"frame {number}")
        height, width = self.depth_size
        try:
            # One byte more than there may be, so that a wrong size is seen without unpacking all.
            values = zlib.decompressobj().decompress(data, 2 * height * width + 1)
        except zlib.error as error:
            raise ValueError(
                f"{self.path}: the depth of frame {number} (byte {frame.depth_start}) is damaged "
                f"({error}); download it again"
            ) from error
        if len(values) != 2 * height * width:
            raise ValueError(
                f"{self.path}: the depth of frame {number} does not have the {height} x {width} "
                "pixels that the header says; download it again"
            )
        depth = np.frombuffer(values, "<u2").reshape(height, width)
        if self.depth_shift == 1000:
            return depth.astype(np.uint16)
        return np.minimum(np.rint(depth * (1000 / self.depth_shift)), 65535).astype(np.uint16)

    def _read_header(self) -> None:
        version, name_bytes = struct.unpack("<IQ", self._next(12, "the header"))
        if version != VERSION or name_bytes > _LONGEST_NAME:
            raise ValueError(
                f"{self.path} is not a .sens file of version {VERSION}; download it again"
            )
        self._next(name_bytes, "the header")
        matrices = np.array(_MATRICES.unpack(self._next(_MATRICES.size, "the header")))
        (
            color_kind,
            depth_kind,
            color_width,
            color_height,
            depth_width,
            depth_height,
            shift,
            count,
        ) = _KINDS_AND_SIZES.unpack(self._next(_KINDS_AND_SIZES.size, "the header"))
        if (color_kind, depth_kind) != (JPEG, ZLIB_U16):
            raise ValueError(
                f"{self.path} has colour of kind {color_kind} and depth of kind {depth_kind}, "
                f"wanted JPEG ({JPEG}) and zlib ({ZLIB_U16})"
            )
        sides = (color_height, color_width, depth_height, depth_width)
        sizes = min(sides) >= 1 and max(math.prod(sides[:2]), math.prod(sides[2:])) <= _MOST_PIXELS
        if not sizes or not _SHIFTS[0] <= shift <= _SHIFTS[1]:
            raise ValueError(
                f"{self.path} has a damaged header: sizes {sides}, shift {shift}; download it again"
            )
        self.color_size, self.depth_size = (color_height, color_width), (depth_height, depth_width)
        self.depth_shift, self.frame_count = float(shift), int(count)
        self.intrinsics = half_pixel_intrinsics(matrices.reshape(4, 4, 4)[2, :3, :3])

    def _index(self, num_frames: int) -> Iterator[SensFrame]:
        for number in range(num_frames):
            what = f"frame {number} of {self.frame_count}"
            *pose, _, _, color, depth = _FRAME.unpack(self._next(_FRAME.size, what))
            start = self._stream.tell()
            if start + color + depth > self._size:
                raise self._ended(what)
            self._stream.seek(color + depth, io.SEEK_CUR)
            matrix = np.array(pose).reshape(4, 4)
            yield SensFrame(matrix, start, color, start + color, depth)

    def _bytes(self, start: int, count: int, what: str) -> bytes:
        self._stream.seek(start)
        return self._next(count, what)

    def _next(self, count: int, what: str) -> bytes:
        data = self._stream.read(count)
        if len(data) < count:
            raise self._ended(what)
        return data

    def _ended(self, what: str) -> ValueError:
        return ValueError(
            f"{self.path} is cut off: it ends at byte {self._size} in {what}; download it again"
        )


def half_pixel_intrinsics(intrinsics: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Intrinsics with the first pixel's centre at (0.5, 0.5), from ScanNet's, who have it at 0.

    The nominal principal point of its 640 x 480 depth, (319.5, 239.5), becomes the middle.
    """
    moved = np.array(intrinsics, dtype=np.float64)
    moved[:2, 2] += 0.5
    return moved


@dataclass(frozen=True)
class RecordedFrame:
    """A frame for `write_sens`."""

    image: UInt8[np.ndarray, "color_height color_width 3"]
    depth_mm: UInt16[np.ndarray, "depth_height depth_width"]
    world_from_cam: Float[np.ndarray, "4 4"]


def write_sens(
    path: Path,
    frames: Iterable[RecordedFrame],
    intrinsics: Float[np.ndarray, "3 3"],
    *,
    jpeg_quality: int = 95,
) -> None:
    """Write a .sens file of version 4, atomically; for tests and for data in ScanNet's form.

    Args:
        path: Of the file.
        frames: All of the size of the first.
        intrinsics: In pixels of the depth, the first pixel's centre at (0.5, 0.5).
        jpeg_quality: Of the colour pictures.

    Raises:
        ValueError: There is no frame, or their sizes differ.
    """
    count, sizes, count_place = 0, None, 0
    with replacing(path) as part, part.open("wb") as stream:
        for frame in frames:
            found = (*frame.image.shape[:2], *frame.depth_mm.shape)
            if sizes is None:
                sizes, count_place = found, _write_header(stream, found, intrinsics)
            if found != sizes:
                raise ValueError(f"frame {count} has the sizes {found}, the first one {sizes}")
            _write_frame(stream, frame, count, jpeg_quality)
            count += 1
        if sizes is None:
            raise ValueError(f"{path}: a .sens file needs at least one frame")
        stream.write(struct.pack("<Q", 0))  # no IMU data
        stream.seek(count_place)
        stream.write(struct.pack("<Q", count))


def _write_header(
    stream: BinaryIO, sizes: tuple[int, ...], intrinsics: Float[np.ndarray, "3 3"]
) -> int:
    """The byte at which the number of frames stands."""
    color_height, color_width, depth_height, depth_width = sizes
    depth = np.eye(4)
    depth[:3, :3] = intrinsics
    depth[:2, 2] -= 0.5
    color = depth.copy()
    color[0] *= color_width / depth_width
    color[1] *= color_height / depth_height
    name = b"StructureSensor"
    matrices = np.stack([color, np.eye(4), depth, np.eye(4)]).ravel()
    stream.write(struct.pack("<IQ", VERSION, len(name)) + name + _MATRICES.pack(*matrices))
    stream.write(
        _KINDS_AND_SIZES.pack(
            JPEG, ZLIB_U16, color_width, color_height, depth_width, depth_height, 1000.0, 0
        )
    )
    return stream.tell() - 8


def _write_frame(stream: BinaryIO, frame: RecordedFrame, number: int, quality: int) -> None:
    jpeg = io.BytesIO()
    Image.fromarray(frame.image).save(jpeg, "JPEG", quality=quality)
    color = jpeg.getvalue()
    depth = zlib.compress(frame.depth_mm.astype("<u2").tobytes())
    time_us = number * 33_333
    pose = frame.world_from_cam.astype(np.float32).ravel()
    stream.write(_FRAME.pack(*pose, time_us, time_us, len(color), len(depth)) + color + depth)
