"""Damage inside of compressed files, which reaches further than damage of their bytes."""

import functools
import gzip
import io
import json
import random
import struct
import zipfile

from mutations import Damage, of_bytes, of_json


def of_gzip(data: bytes, rng: random.Random) -> bytes:
    """The inflated bytes damaged, and a sound stream made of them; or as `of_bytes`."""
    if rng.random() < 0.2:
        return of_bytes(data, rng)
    return gzip.compress(of_bytes(gzip.decompress(data), rng), 1)


def of_zip(data: bytes, rng: random.Random) -> bytes:
    """One part damaged, left out or doubled, and a sound archive made of them."""
    if rng.random() < 0.2:
        return of_bytes(data, rng)
    parts = list(_parts(data))
    which = rng.randrange(len(parts))
    if rng.random() < 0.5:  # most can be said wrong there
        which = next(i for i, (name, _) in enumerate(parts) if name.endswith(".json"))
    name, content = parts[which]
    damage = of_json if name.endswith(".json") else of_bytes
    kind = rng.randrange(12)
    if kind == 0:
        del parts[which]
    elif kind == 1:
        parts[which] = (name, parts[rng.randrange(len(parts))][1])
    else:
        parts[which] = (name, damage(content, rng))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in parts:
            archive.writestr(name, content)
    return stream.getvalue()


@functools.lru_cache(1)  # one archive is damaged many times
def _parts(data: bytes) -> tuple[tuple[str, bytes], ...]:
    """Names and contents of an archive's parts."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return tuple((name, archive.read(name)) for name in archive.namelist())


def of_glb(data: bytes, rng: random.Random) -> bytes:
    """The description damaged, with sizes that fit; or as `of_bytes`."""
    if rng.random() < 0.3:
        return of_bytes(data, rng)
    (length,) = struct.unpack_from("<I", data, 12)
    try:
        text = of_json(data[20 : 20 + length], rng)
    except json.JSONDecodeError:
        return of_bytes(data, rng)
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


INSIDE: dict[str, Damage] = {".spz": of_gzip, ".sog": of_zip, ".glb": of_glb}
"""By the ending of a file; others are damaged as bytes."""
