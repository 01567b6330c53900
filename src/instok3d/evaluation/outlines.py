"""Outlines of objects in photos, drawn by hand as polygons: the truth for masks of real photos.

A file says which photo it belongs to by the SHA-256 of the photo's bytes and holds none of its
pixels. The format is in docs/formats.md.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt16

from instok3d.reading import naming_damage, number, one_of, read_json, text, whole_number

FORMAT = "instok3d-outlines-1"
OWN_OUTLINES = Path(__file__).parents[1] / "assets" / "outlines"
"""Those that come with the package."""
MAX_SIDE = 65_535
MAX_OBJECTS = 65_535
"""So that ids fit into 16 bits."""
MAX_COORDINATE = 1e6
"""Pixels; outlines may leave the picture, but not for good."""

Ring = Float[np.ndarray, "_vertex 2"]


@dataclass(frozen=True)
class OutlinedObject:
    """One object: what lies in any of its polygons and in none of its holes."""

    name: str
    """What a person would call it."""
    stuff: bool
    """Whether it is a surface of the room, such as a wall, and not an object."""
    polygons: tuple[Ring, ...]
    """Vertices x, y in pixels of the upright photo; the last one joins the first."""
    holes: tuple[Ring, ...] = ()

    def mask(self, height: int, width: int) -> Bool[np.ndarray, "height width"]:
        """The pixels of the photo whose centres are in the object."""
        inside = np.zeros((height, width), dtype=bool)
        for ring in self.polygons:
            inside |= filled(ring, height, width)
        for ring in self.holes:
            inside &= ~filled(ring, height, width)
        return inside


@dataclass(frozen=True)
class PhotoOutlines:
    """The objects of one photo, those behind before those in front of them."""

    photo: str
    """Name of the photo, for people."""
    sha256: str
    """Of the bytes of the photo's file."""
    height: int
    """Of the upright photo."""
    width: int
    objects: tuple[OutlinedObject, ...]

    def id_map(self) -> UInt16[np.ndarray, "height width"]:
        """Each pixel's object, counted from 1 in their order; 0 where nothing was outlined.

        Where objects overlap, the later one covers the earlier one.
        """
        ids = np.zeros((self.height, self.width), dtype=np.uint16)
        for number_, item in enumerate(self.objects, 1):
            ids[item.mask(self.height, self.width)] = number_
        return ids


def filled(ring: Ring, height: int, width: int) -> Bool[np.ndarray, "{height} {width}"]:
    """The pixels whose centres lie inside a polygon, by the even-odd rule.

    A centre on a left or upper edge is inside, one on a right or lower edge is not, so that
    polygons that share an edge share no pixel.
    """
    crossings = np.zeros((height, width + 1), dtype=np.int32)
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        # Rows whose centres lie in [top, bottom): an end that two edges share counts once.
        first, last = (int(np.clip(np.ceil(y - 0.5), 0, height)) for y in sorted((y0, y1)))
        rows = np.arange(first, last)
        x = x0 + (rows + 0.5 - y0) * (x1 - x0) / (y1 - y0) if len(rows) else rows
        np.add.at(crossings, (rows, np.ceil(x - 0.5).clip(0, width).astype(np.int64)), 1)
    return (crossings.cumsum(axis=1)[:, :width] & 1).astype(bool)


def read_outlines(folder: Path = OWN_OUTLINES) -> dict[str, PhotoOutlines]:
    """The outlines in the .json files of a folder, by the SHA-256 of their photo.

    Args:
        folder: Not searched below its first level; those that come with the package by default.

    Raises:
        FileNotFoundError: There is no such folder, or no .json file in it.
        ValueError: A file is damaged, or two belong to one photo.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder of outlines {folder}")
    paths = sorted(folder.glob("[!.]*.json"))
    if not paths:
        raise FileNotFoundError(
            f"{folder} holds no outlines: wanted a .json file for each photo, as in docs/formats.md"
        )
    found: dict[str, PhotoOutlines] = {}
    origin: dict[str, Path] = {}
    for path in paths:
        outlines = read_photo_outlines(path)
        if outlines.sha256 in found:
            raise ValueError(
                f"{origin[outlines.sha256]} and {path} outline the same photo; keep one of them"
            )
        found[outlines.sha256], origin[outlines.sha256] = outlines, path
    return found


def read_photo_outlines(path: Path) -> PhotoOutlines:
    """One file of outlines.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, of another format, or a polygon has fewer than 3 vertices.
    """
    remedy = "mend it by the table in docs/formats.md, or leave the file out"
    value = read_json(path, remedy)
    with naming_damage(path, remedy):
        one_of(value["format"], [FORMAT])
        digest = text(value["sha256"]).lower()
        if len(digest) != 64 or set(digest) - set("0123456789abcdef"):
            raise ValueError(f"sha256 {digest[:80]!r} is none of 64 hexadecimal digits")
        objects = _list(value["objects"], "objects")
        if len(objects) > MAX_OBJECTS:
            raise ValueError(f"{len(objects)} objects are more than {MAX_OBJECTS}")
        return PhotoOutlines(
            photo=text(value["photo"]),
            sha256=digest,
            height=whole_number(value["height"], 1, MAX_SIDE),
            width=whole_number(value["width"], 1, MAX_SIDE),
            objects=tuple(_object(each) for each in objects),
        )


def _object(value: Any) -> OutlinedObject:
    name = text(value["name"])
    polygons = _rings(value["polygons"], f"polygons of {name!r}")
    if not polygons:
        raise ValueError(f"the object {name!r} has no polygon")
    return OutlinedObject(
        name=name,
        stuff=bool(one_of(value.get("stuff", False), [True, False])),
        polygons=polygons,
        holes=_rings(value.get("holes", []), f"holes of {name!r}"),
    )


def _rings(value: Any, where: str) -> tuple[Ring, ...]:
    return tuple(_ring(each, where) for each in _list(value, where))


def _ring(value: Any, where: str) -> Ring:
    points = [[number(part) for part in _list(point, where)] for point in _list(value, where)]
    if len(points) < 3 or any(len(point) != 2 for point in points):
        raise ValueError(f"the {where} must have 3 or more vertices [x, y]")
    ring = np.array(points, dtype=np.float64)
    if np.abs(ring).max() > MAX_COORDINATE:
        raise ValueError(f"the {where} leave the picture by more than {MAX_COORDINATE:.0e} pixels")
    return ring


def _list(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f"the {where} are no list")
    return value
