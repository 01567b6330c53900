"""Small files that promise a lot are refused before memory is taken for it."""

import contextlib
import gzip
import io
import json
import resource
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from instok3d.formats.registry import read_splats
from mutations import limits
from splat_scenes import furnished_scene

HEADER = "<4sIIBBBB"


@contextlib.contextmanager
def little_memory(file: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """At most four times the file and 64 MB more than now."""
    monkeypatch.setattr("mutations.SPARE_BYTES", 4 * file.stat().st_size + 64 * 2**20)
    with limits():
        assert resource.getrlimit(resource.RLIMIT_AS)[0] > 0
        yield


def spz_bomb(count: int) -> bytes:
    body = struct.pack(HEADER, b"NGSP", 3, count, 3, 12, 0, 0)
    return gzip.compress(body + bytes(50_000_000), 1)


def sog_bomb(method: int = zipfile.ZIP_DEFLATED, length: int = 100_000_000) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method, compresslevel=1) as archive:
        archive.writestr("meta.json", b" " * length)
    return stream.getvalue()


def packed_bomb() -> bytes:
    """A .sog whose only part is said to be packed in two gigabytes."""
    data = bytearray(sog_bomb(length=100))
    struct.pack_into("<I", data, data.index(b"PK\1\2") + 20, 2**31 - 1)
    return bytes(data)


def picture_bomb() -> bytes:
    """A .sog whose first picture has far more pixels than it has bytes."""
    picture, stream = io.BytesIO(), io.BytesIO()
    Image.fromarray(np.zeros((3000, 3000, 4), np.uint8)).save(picture, "WEBP", lossless=True)
    meta = {"version": 2, "count": 10, "means": {"files": ["a.webp", "a.webp"]}}
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        archive.writestr("a.webp", picture.getvalue())
    return stream.getvalue()


def ksplat_bomb(sections: int, count: int) -> bytes:
    header = bytearray(4096 + 1024)
    header[1] = 1
    struct.pack_into("<I", header, 4, sections)
    struct.pack_into("<I", header, 16, count)
    struct.pack_into("<II", header, 4096, count, count)
    return bytes(header)


def v4_bomb() -> bytes:
    zstandard = pytest.importorskip("zstandard")
    stream = zstandard.compress(bytes(200_000_000))
    count, widths = 10_000_000, (9, 1, 3, 3, 4)
    table = b"".join(struct.pack("<QQ", len(stream), count * width) for width in widths)
    head = struct.pack(HEADER, b"NGSP", 4, count, 0, 12, 0, 5) + struct.pack("<I", 32) + bytes(12)
    return head + table + stream * 5


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("count.spz", lambda: spz_bomb(2**32 - 1)),
        ("zeros.spz", lambda: spz_bomb(800_000)),
        ("streams.spz", v4_bomb),
        ("meta.sog", sog_bomb),
        ("method.sog", lambda: sog_bomb(zipfile.ZIP_LZMA, 100)),
        ("packed.sog", packed_bomb),
        ("picture.sog", picture_bomb),
        ("sections.ksplat", lambda: ksplat_bomb(2**32 - 1, 1)),
        ("count.ksplat", lambda: ksplat_bomb(1, 2**32 - 1)),
        ("rows.ply", lambda: b"ply\nformat ascii 1.0\nelement vertex 99999999999\n"
                             b"property float x\nend_header\n1\n"),
        ("nothing.ply", lambda: b"ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n"),
    ],
)  # fmt: skip
def test_is_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, make
):
    file = tmp_path / name
    file.write_bytes(make())
    with little_memory(file, monkeypatch), pytest.raises(ValueError, match=name) as found:
        read_splats(file)
    assert "\n" not in str(found.value)


def test_headers_that_lie_inside_a_sound_gzip_stream(tmp_path: Path):
    from instok3d.formats.registry import export_scene

    export_scene(furnished_scene(50), tmp_path / "a.spz")
    whole = gzip.decompress((tmp_path / "a.spz").read_bytes())
    for at, value in [(4, 9), (8, 51), (12, 9), (13, 99), (14, 2)]:
        changed = bytearray(whole)
        changed[at] = value
        (tmp_path / "a.spz").write_bytes(gzip.compress(bytes(changed)))
        with pytest.raises(ValueError, match=r"a\.spz is damaged"):
            read_splats(tmp_path / "a.spz")
