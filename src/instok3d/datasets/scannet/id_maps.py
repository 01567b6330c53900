"""ScanNet's zip archives of 2D annotations: one PNG of ids for each frame of a scan."""

import io
import re
import reprlib
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import UInt16
from PIL import Image

from instok3d.files import replacing
from instok3d.photos.image_decoding import naming_damage as naming_picture_damage
from instok3d.reading import naming_damage, open_zip, read_json, whole_number

Kind = Literal["instance-filt", "label-filt"]
"""instance-filt: 8-bit, aggregation id + 1; label-filt: 16-bit raw label ids; 0 = unannotated."""

MOST_TIMES_THE_PICTURE = 16
"""No id map has more pixels than so many times its picture's; ScanNet's have as many as that."""


class IdMaps:
    """The id maps of one archive, found by frame number; use it in a `with` block.

    Args:
        path: `{scan}_2d-instance-filt.zip` or `{scan}_2d-label-filt.zip`.
        kind: Which of the two it must be.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no zip archive, is cut off, or holds no map of this kind.
    """

    def __init__(self, path: Path, kind: Kind) -> None:
        if not path.is_file():
            raise FileNotFoundError(
                f"there is no archive {path}; download it, or prepare without these maps"
            )
        self.path = path
        with naming_damage(path, "download it again"):
            self._archive = open_zip(path)
        names = self._archive.namelist()
        pattern = re.compile(rf"(?:.*/)?{kind}/0*(\d{{1,9}})\.png")
        found = [(match, name) for name in names if (match := pattern.fullmatch(name))]
        self._members = {int(match[1]): name for match, name in found}
        if not self._members:
            self._archive.close()
            files = [name for name in names if not name.endswith("/")]
            some = f"{reprlib.repr(files[0])} and the like" if files else "nothing"
            raise ValueError(
                f"{path} holds no {kind}/<frame>.png but {some}; download the archive of {kind}"
            )

    def __enter__(self) -> "IdMaps":
        return self

    def __exit__(self, *error: object) -> None:
        self._archive.close()

    @property
    def last_frame(self) -> int:
        """The largest frame number that has a map."""
        return max(self._members)

    def read(self, frame: int, picture_pixels: int) -> UInt16[np.ndarray, "height width"] | None:
        """The ids of one frame; None where the archive has none.

        Args:
            frame: Its number.
            picture_pixels: How many its picture has; a map that is much larger is not unpacked.

        Raises:
            ValueError: The map is damaged, much too large, or not a picture of one whole number a
                pixel.
        """
        if frame not in self._members:
            return None
        name = self._members[frame]
        most_bytes = 4 * MOST_TIMES_THE_PICTURE * picture_pixels + 65536  # of a PNG with ids
        where = f"{self.path}: {name}"
        with naming_damage(where, "download it again"), self._archive.open(name) as stream:
            data = stream.read(most_bytes + 1)
        if len(data) > most_bytes:
            raise ValueError(
                f"{where} unpacks to more than {most_bytes} bytes, far too many for a "
                f"picture of {picture_pixels} pixels; download the archive again"
            )
        return read_id_png(data, where, picture_pixels)


def read_id_png(data: bytes, what: str, picture_pixels: int) -> UInt16[np.ndarray, "height width"]:
    """The ids in the bytes of an 8-bit or 16-bit PNG.

    Args:
        data: The file.
        what: Its name for messages.
        picture_pixels: How many the picture has that the ids belong to.

    Raises:
        ValueError: It is damaged, much larger than its picture, or not a picture of one whole
            number a pixel.
    """
    remedy = "wanted a PNG of ids; make or download it again"
    with naming_picture_damage(what, remedy):
        image = Image.open(io.BytesIO(data), formats=["PNG"])
    if image.width * image.height > MOST_TIMES_THE_PICTURE * picture_pixels:
        raise ValueError(
            f"{what} has {image.width} x {image.height} pixels, its picture only {picture_pixels} "
            "in all; give the ids of this picture"
        )
    with naming_picture_damage(what, remedy):
        pixels = np.asarray(image)
    if image.mode not in ("L", "I;16", "I") or pixels.max(initial=0) > 65535:
        raise ValueError(
            f"{what} has {image.mode} pixels, wanted a grey PNG of 8 or 16 bits whose values are "
            "the ids"
        )
    return pixels.astype(np.uint16)


def largest_instance(path: Path) -> int:
    """The largest id that instance maps of a scan may hold, by its `{scan}.aggregation.json`.

    Raises:
        ValueError: The file is damaged.
    """
    remedy = "download it again"
    table = read_json(path, remedy)
    with naming_damage(path, remedy):
        return max((whole_number(group["id"]) + 1 for group in table["segGroups"]), default=0)


def write_id_maps(path: Path, kind: Kind, maps: Mapping[int, np.ndarray]) -> None:
    """Write an archive in ScanNet's form, atomically; for tests and for data in its form.

    Args:
        path: Of the zip file.
        kind: instance-filt is written with 8 bits, label-filt with 16.
        maps: Ids by frame number, [height, width].

    Raises:
        ValueError: An instance id is above 255.
    """
    with replacing(path) as part, zipfile.ZipFile(part, "w") as archive:
        for frame, ids in maps.items():
            if kind == "instance-filt" and ids.max(initial=0) > 255:
                raise ValueError(f"frame {frame} has the instance id {ids.max()}, the most is 255")
            png = io.BytesIO()
            pixels = ids.astype(np.uint8 if kind == "instance-filt" else np.uint16)
            Image.fromarray(pixels).save(png, "PNG")
            archive.writestr(f"{kind}/{frame}.png", png.getvalue())
