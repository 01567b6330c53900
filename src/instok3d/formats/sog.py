"""PlayCanvas's .sog: numbers in lossless WebP pictures within a zip; by gaussforge when written."""

import io
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from instok3d.files import replacing
from instok3d.formats.packing import check_growth, from_smallest_three
from instok3d.formats.ply import write_ply
from instok3d.formats.registry import ExportOptions
from instok3d.formats.splats import Splats, drawable_splats
from instok3d.reading import naming_damage, open_zip, parse_json, whole_number
from instok3d.scene.scene import Scene

VERSION = 2
MAX_ENTRIES = 32
PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Other methods take memory by what the file says."""
LARGEST_PART = 0xFC
"""The fourth byte of a quaternion, less the place of its largest component in w, x, y, z."""
PALETTE_WIDTH = 64
"""Entries of the colour palette side by side in its picture."""
MAX_PALETTE = 2**16
BANDS = {1: 3, 2: 8, 3: 15}
"""Coefficients above the constant one, by degree."""
REMEDY = "export it again"


def write_sog(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a scene's Gaussians in their axes; their order is lost.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
        ModuleNotFoundError: gaussforge is not installed.
        ValueError: There are no Gaussians.
    """
    try:
        from gaussforge import GaussForge
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            ".sog is written by gaussforge: pip install 'instok3d[formats]', or write .spz instead"
        ) from error
    if not len(scene.gaussians.means):
        raise ValueError(f"{path}: .sog cannot hold a scene without Gaussians")
    degree = min(options.sh_degree, int(scene.gaussians.sh.shape[1] ** 0.5) - 1)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "scene.ply"
        write_ply(plain, scene.gaussians, sh_degree=degree)
        made = GaussForge().convert(plain.read_bytes(), "ply", "sog")
    if "error" in made:
        raise ValueError(f"gaussforge could not write {path}: {made['error']}")
    with replacing(path, overwrite=options.overwrite) as part:
        part.write_bytes(made["data"])


def read_sog(path: Path) -> Splats:
    """The Gaussians of a .sog file of version 2, in the file's order.

    The sizes of all parts are compared with the file's before they are unpacked.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is damaged, or of another version.
    """
    with naming_damage(path, REMEDY), open_zip(path) as archive:
        entries = archive.infolist()
        if len(entries) > MAX_ENTRIES:
            raise ValueError(f"it has {len(entries)} parts")
        if any(entry.compress_type not in PLAIN for entry in entries):
            raise ValueError("its parts are packed by another method than stored or deflated")
        check_growth(path, sum(entry.file_size for entry in entries))
        about = parse_json(archive.read("meta.json"), path, REMEDY)
        version = about.get("version", VERSION if "count" in about else None)
        if version != VERSION:
            raise ValueError(f"it is of version {version}; wanted {VERSION}")
        count = whole_number(about["count"], 0, 2**31 - 1)
        parts = _Parts(path, archive, count)
        opacities, sh = _colors(parts, about)
        return drawable_splats(
            path,
            means=torch.from_numpy(_means(parts, about["means"])),
            quats=torch.from_numpy(_quats(parts, about["quats"])),
            scales=torch.from_numpy(
                np.exp(_codebook(about["scales"])[parts.rows(about["scales"], 0)[:, :3]])
            ),
            opacities=opacities,
            sh=sh,
        )


class _Parts:
    """The pictures of an archive, read one at a time."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, count: int) -> None:
        self._path, self._archive, self.count = path, archive, count

    def picture(self, about: dict[str, Any], index: int) -> UInt8[np.ndarray, "height width 4"]:
        """One of the files that an entry of meta.json names, as RGBA."""
        data = self._archive.read(about["files"][index])
        with Image.open(io.BytesIO(data), formats=["WEBP"]) as picture:
            check_growth(self._path, 4 * picture.width * picture.height)
            return np.asarray(picture.convert("RGBA"))

    def rows(self, about: dict[str, Any], index: int) -> UInt8[np.ndarray, "row 4"]:
        """The pixels that stand for Gaussians."""
        pixels = self.picture(about, index).reshape(-1, 4)
        if len(pixels) < self.count:
            raise ValueError(f"a picture has {len(pixels)} pixels for {self.count} Gaussians")
        return pixels[: self.count]


def _means(parts: _Parts, about: dict[str, Any]) -> Float[np.ndarray, "row 3"]:
    """From 16 bits between bounds, signed logarithms of 1 + |x|."""
    low, high = parts.rows(about, 0)[:, :3], parts.rows(about, 1)[:, :3]
    shares = (low + 256.0 * high) / 65535
    start, end = (np.array(about[name], np.float64).reshape(3) for name in ("mins", "maxs"))
    values = start + shares * (end - start)
    with np.errstate(over="ignore"):
        return (np.sign(values) * np.expm1(np.abs(values))).astype(np.float32)


def _quats(parts: _Parts, about: dict[str, Any]) -> Float[np.ndarray, "row 4"]:
    pixels = parts.rows(about, 0)
    largest = np.clip(pixels[:, 3].astype(np.int64) - LARGEST_PART, 0, 3)
    return from_smallest_three(largest, (pixels[:, :3] / 127.5 - 1) / 2**0.5)


def _colors(
    parts: _Parts, about: dict[str, Any]
) -> tuple[Float[Tensor, " row"], Float[Tensor, "row coefficient 3"]]:
    """Opacities and coefficients; those above the constant one come from a palette."""
    pixels = parts.rows(about["sh0"], 0)
    constant = _codebook(about["sh0"])[pixels[:, :3]][:, None]
    opacities = torch.from_numpy(pixels[:, 3] / np.float32(255))
    above = about.get("shN")
    if above is None:
        return opacities, torch.from_numpy(constant)
    width = BANDS[above["bands"]]
    entries = whole_number(above["count"], 1, MAX_PALETTE)
    palette = parts.picture(above, 0)
    if palette.shape[1] != PALETTE_WIDTH * width or palette.shape[0] * PALETTE_WIDTH < entries:
        raise ValueError(f"its palette is {palette.shape[:2]}, too small for {entries} entries")
    palette = palette[:, :, :3].reshape(-1, width, 3)[:entries]
    labels = parts.rows(above, 1).astype(np.int64)
    labels = labels[:, 0] + 256 * labels[:, 1]
    if len(labels) and labels.max() >= entries:
        raise ValueError(f"a Gaussian's colour is entry {labels.max()} of {entries}")
    rest = _codebook(above)[palette][labels]
    return opacities, torch.from_numpy(np.concatenate([constant, rest], axis=1))


def _codebook(about: dict[str, Any]) -> Float[np.ndarray, "256"]:
    """What the values of a byte stand for."""
    values = np.array(about["codebook"], np.float32)
    if values.ndim != 1 or not 0 < len(values) <= 256:
        raise ValueError("a codebook has not 256 values")
    return np.concatenate([values, np.zeros(256 - len(values), np.float32)])
