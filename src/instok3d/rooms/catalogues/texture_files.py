"""Textures from files of a catalogue, for floors, walls, wood and cloth."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from instok3d.reading import naming_damage
from instok3d.rooms import colors
from instok3d.rooms.catalogues.entries import Entry, license_fault, usable_entries
from instok3d.rooms.textures import SIZE, Texture, quantised, resampled

REMEDY = "take it out of the catalogue, or save it again as JPEG or PNG"
MAX_TEXELS = 64_000_000
USES = ("floor", "wall", "wood", "cloth")
HELD_OUT_WORDS = ("brick", "concrete", "marble", "statuaretto", "zigzag")
"""Words in names of files that show what only transfer rooms have (`HELD_OUT_MATERIALS`)."""
PLAIN_CONTRAST = 0.16
"""Standard deviation of the brightness above which a texture is a pattern: not in easy rooms."""


@dataclass(frozen=True)
class TextureCatalogue:
    """The texture files of a folder that rooms may use."""

    folder: Path
    entries: tuple[Entry, ...]
    patterned: frozenset[str]
    """Stems of those with strong patterns."""
    left_out: dict[str, int]
    """How many records are not used, by the reason."""

    @staticmethod
    def open(folder: Path) -> "TextureCatalogue":
        """Read a catalogue, and once every texture in it that rooms may use.

        Raises:
            FileNotFoundError: The folder has no catalogue, or a texture is missing.
            ValueError: The catalogue or a texture is damaged, or no texture is usable.
        """

        def judged(record: dict[str, Any]) -> tuple[Entry, str]:
            file = Path(record["file"])
            use = use_of(record["kind"], file.stem)
            entry = Entry(file, file.stem, record["source"], record["license"], use)
            unknown = "kind other than " + ", ".join(USES)
            return entry, license_fault(entry) if use in USES else unknown

        entries, left_out = usable_entries(folder, "texture", ("kind", "source"), judged)
        loaded = {entry.stem: load_texture(folder / entry.file) for entry in entries}
        strong = (stem for stem, t in loaded.items() if t.mean(-1).std() / 255 > PLAIN_CONTRAST)
        return TextureCatalogue(folder, entries, frozenset(strong), left_out)

    def draw(
        self, rng: np.random.Generator, use: str, *, plain: bool, held_out: bool
    ) -> tuple[Texture, Entry] | None:
        """A tinted, sometimes turned texture for a use, and where it is from; None for none.

        Args:
            rng: Draws the file, its tint and its orientation.
            use: One of USES.
            plain: None with a strong pattern.
            held_out: Whether what only transfer rooms have is allowed.
        """
        fitting = [entry for entry in self.entries if entry.use == use]
        if plain:
            fitting = [entry for entry in fitting if entry.stem not in self.patterned]
        if not held_out:
            fitting = [entry for entry in fitting if not _is_held_out(entry.stem)]
        if not fitting:
            return None
        entry = fitting[int(rng.integers(len(fitting)))]
        texture = load_texture(self.folder / entry.file)
        if rng.random() < 0.5:
            texture = texture.transpose(1, 0, 2)
        tint = rng.uniform(0.8, 1.1) * (1 + rng.normal(0, 0.03, 3))
        if use in ("wall", "cloth") and rng.random() < 0.5:
            tint = tint * colors.soft(rng)
        picture = np.asarray(texture, np.float32) / 255 * np.asarray(tint, np.float32)
        return quantised(picture), entry


def use_of(kind: str, stem: str) -> str:
    """What a texture is for: its kind, but parquet is a floor, and "a wall" of bricks is a wall."""
    words = stem.lower()
    if kind == "wood" and any(word in words for word in ("parquet", "plank", "floor")):
        return "floor"
    if kind == "floor" and "wall" in words:
        return "wall"
    return kind


def _is_held_out(stem: str) -> bool:
    return any(word in stem.lower() for word in HELD_OUT_WORDS)


@lru_cache(512)
def load_texture(path: Path) -> Texture:
    """A file as a texture; the shorter side of a long one is repeated.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged or too large.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    with naming_damage(path, REMEDY), Image.open(path, formats=("JPEG", "PNG")) as opened:
        if opened.width * opened.height > MAX_TEXELS:
            raise ValueError(f"it has {opened.width} x {opened.height} texels")
        return resampled(_squared(np.asarray(opened.convert("RGB"))), np.ones(3))


def _squared(
    picture: UInt8[np.ndarray, "height width 3"],
) -> UInt8[np.ndarray, "rows columns 3"]:
    """A tileable picture repeated along its shorter side until it is nearly square."""
    height, width = picture.shape[:2]
    repeats = max(1, min(SIZE, round(max(height, width) / min(height, width))))
    return np.tile(picture, (repeats, 1, 1) if width > height else (1, repeats, 1))
