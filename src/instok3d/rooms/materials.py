"""Materials, and the maker that draws the numbers and the materials of one object."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from instok3d.rooms import colors, pictures, prints, textures
from instok3d.rooms.catalogues.texture_files import TextureCatalogue
from instok3d.rooms.colors import Color, Number
from instok3d.rooms.textures import Texture

Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface looks."""

    kind: str
    """Name for the attributes: wood, fabric, leather, metal, plastic, ..."""
    texture: Texture
    tile_m: Number = 1.0
    """Side of one texture tile, metres; 1 for pictures whose uvs are 0..1 already."""
    gloss: Number = 0.0
    """Weight of the reflection, seen in hard rooms only."""
    emission: Number = 0.0
    """Radiance of its own light relative to the texture; 0 = none."""
    light: Literal["none", "lamp", "screen", "window"] = "none"
    """Lamps and windows are scaled together to light the room; screens are left as drawn."""


@dataclass(frozen=True)
class Style:
    """What a room's objects may be made of."""

    plain: bool = False
    """No patterned fabrics and wallpapers (easy rooms)."""
    held_out: bool = False
    """HELD_OUT_MATERIALS may appear (transfer rooms)."""
    textures: TextureCatalogue | None = None
    """Files that half of the floors, walls, woods and cloths are made of."""


HELD_OUT_MATERIALS = ("brick", "concrete", "marble", "zigzag")
"""Kinds of surface that only transfer rooms have."""


class Maker:
    """Draws the numbers and the materials of one object from that object's own stream."""

    def __init__(self, rng: np.random.Generator, style: Style | None = None):
        self.rng = rng
        self.style = style or Style()

    def uniform(self, low: Number, high: Number) -> float:
        """A number from [low, high)."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: Number) -> bool:
        """True as often as said."""
        return bool(self.rng.random() < probability)

    def integer(self, low: int, high: int) -> int:
        """An integer from low to high - 1."""
        return int(self.rng.integers(low, high))

    def choice(self, values: Sequence[Value]) -> Value:
        """One of the values."""
        return values[self.integer(0, len(values))]

    def plain(
        self, kind: str, color: Color | Number, unevenness: Number = 0.01, **look: Any
    ) -> Material:
        """One colour (a number is a grey); `look` holds further fields of the Material."""
        color = np.ones(3) * color
        return Material(kind, textures.plain(self.rng, color, unevenness), **look)

    def from_file(
        self, use: str, tile_m: tuple[Number, Number], gloss: Number = 0.0
    ) -> "Material | None":
        """A material from a texture file for a use, half of the time; None without files."""
        files, style = self.style.textures, self.style
        if files is None or not self.chance(0.5):
            return None
        drawn = files.draw(self.rng, use, plain=style.plain, held_out=style.held_out)
        if drawn is None:
            return None
        return Material(use, drawn[0], self.uniform(*tile_m), gloss)

    def wood(self) -> Material:
        """Some wood."""
        if found := self.from_file("wood", (0.7, 1.5), 0.06):
            return found
        texture = textures.wood(self.rng, colors.wood(self.rng))
        return Material("wood", texture, self.uniform(0.8, 1.6), self.uniform(0, 0.12))

    def pattern(self, kind: str, first: Color, second: Color, tile_m: Number) -> Material:
        """Two colours in a pattern; zigzag only where held-out materials may appear."""
        names = [n for n in textures.PATTERNS if n != "zigzag" or self.style.held_out]
        if self.style.held_out and self.chance(0.5):
            names = ["zigzag"]
        texture = textures.pattern(self.rng, first, second, self.choice(names))
        return Material(kind, texture, tile_m)

    def fabric(self, color: Color | None = None) -> Material:
        """Cloth, a quarter of it patterned."""
        if color is None and (found := self.from_file("cloth", (0.3, 0.9))):
            return found
        color = colors.cloth(self.rng) if color is None else color
        if not self.style.plain and self.chance(0.25):
            second = colors.cloth(self.rng)
            return self.pattern("fabric", color, second, self.uniform(0.25, 0.9))
        return Material("fabric", textures.fabric(self.rng, color), self.uniform(0.3, 0.8))

    def leather(self) -> Material:
        """Leather in brown, black or dark blue."""
        hue = self.choice([0.05, 0.07, 0.0, 0.6])
        color = colors.hsv(hue, self.uniform(0.1, 0.7), self.uniform(0.08, 0.5))
        return self.plain("leather", color, 0.05, gloss=0.12)

    def upholstery(self) -> Material:
        """Fabric or leather."""
        return self.leather() if self.chance(0.25) else self.fabric()

    def metal(self) -> Material:
        """Grey metal from black to chrome."""
        value = self.choice([0.08, 0.15, 0.45, 0.65, 0.8])
        tint = np.array([1, 1, self.uniform(0.9, 1.03)])
        return self.plain("metal", value * tint, gloss=0.25)

    def plastic(self, color: Color | Number | None = None) -> Material:
        """Smooth plastic in any colour."""
        chosen = colors.vivid(self.rng, (0.0, 0.9), (0.1, 0.95)) if color is None else color
        return self.plain("plastic", chosen, gloss=0.1)

    def ceramic(self, color: Color | Number | None = None) -> Material:
        """Glazed ceramic in any colour."""
        chosen = colors.vivid(self.rng, (0.0, 0.8), (0.2, 0.95)) if color is None else color
        return self.plain("ceramic", chosen, gloss=0.15)

    def white(self, kind: str = "enamel") -> Material:
        """Nearly white, glossy."""
        value = self.uniform(0.8, 0.95)
        return self.plain(kind, value * np.array([1, 1, self.uniform(0.93, 1)]), gloss=0.15)

    def dark(self) -> Material:
        """Black plastic."""
        return self.plastic(0.05)

    def furniture(self) -> Material:
        """What furniture is made of: mostly wood, else painted."""
        kind = self.rng.random()
        if kind < 0.62:
            return self.wood()
        if kind < 0.82:
            return self.plain("painted wood", colors.soft(self.rng), 0.015, gloss=0.08)
        color = colors.vivid(self.rng, (0.1, 0.7), (0.1, 0.8))
        return self.plain("painted wood", color, 0.015, gloss=0.08)

    def other_furniture(self, same: Material, probability: Number) -> Material:
        """The same material as often as said, else another one."""
        return same if self.chance(probability) else self.furniture()

    def stone(self) -> Material:
        """A worktop: granite, or marble where held-out materials may appear."""
        color = colors.hsv(self.rng.random(), self.uniform(0, 0.15), self.uniform(0.2, 0.95))
        if self.style.held_out:
            return Material("marble", textures.marble(self.rng, color), gloss=0.2)
        return Material("granite", textures.granite(self.rng, color), gloss=0.2)

    def shade(self, low: Number, high: Number, lit: Number) -> Material:
        """A warm lamp shade, shining as often as said."""
        color = colors.hsv(self.uniform(0.08, 0.13), self.uniform(0.05, 0.45), 0.98)
        power = self.uniform(low, high) if self.chance(lit) else 0.0
        light = "lamp" if power else "none"
        return self.plain("fabric", color, 0.02, emission=power, light=light)

    def screen(self) -> Material:
        """A screen, on or off."""
        picture = pictures.screen(self.rng)
        power = self.uniform(0.3, 1.2) if self.chance(0.6) else 0.0
        light = "screen" if power else "none"
        return Material("glass", picture, gloss=0.2, emission=power, light=light)

    def books(self) -> Material:
        """A row of books, 35 cm to the tile."""
        return Material("paper", pictures.book_spines(self.rng))

    def label(self) -> Material:
        """The label around a bottle."""
        return self.plain("paper", colors.vivid(self.rng), 0.0)

    def packages(self) -> Material:
        """A sheet of prints for covers and packages (`prints.CELLS`)."""
        return Material("paper", prints.packages(self.rng))

    def papers(self) -> Material:
        """A sheet of pages (`prints.CELLS`)."""
        return Material("paper", prints.papers(self.rng))

    def glow(self, low: Number, high: Number) -> Material:
        """The glass of a ceiling lamp."""
        color = colors.hsv(0.1, self.uniform(0.02, 0.2), 1)
        power = self.uniform(low, high)
        return self.plain("glass", color, 0.0, emission=power, light="lamp")

    def window_view(self, daylight: Number) -> Material:
        """What windows show, which lights the room."""
        return Material("glass", pictures.outdoors(self.rng), emission=daylight, light="window")

    def ceiling(self) -> Material:
        """A white ceiling."""
        white = colors.hsv(0.1, self.uniform(0, 0.06), self.uniform(0.85, 0.97))
        return Material("paint", textures.paint(self.rng, white), 2)

    def floor(self, room_type: str) -> Material:
        """Wood, carpet or tiles; concrete where held-out materials may appear."""
        if found := self.from_file("floor", (0.9, 2.2), 0.07):
            return found
        kind, rng = self.rng.random(), self.rng
        wet = room_type in ("bathroom", "kitchen")
        if self.style.held_out and self.chance(0.4):
            return Material("concrete", textures.concrete(rng, self.uniform(0.35, 0.7)), 2)
        if wet and kind < 0.75:
            chequered = self.chance(0.2) and not self.style.plain
            first = colors.hsv(rng.random(), self.uniform(0, 0.25), self.uniform(0.45, 0.95))
            dark = colors.hsv(0.6, 0.1, 0.2)
            pair = (colors.hsv(0.1, 0.05, 0.9), dark) if chequered else (first, None)
            return Material("tiles", textures.tiles(rng, *pair), self.uniform(0.9, 1.8), gloss=0.08)
        if kind < 0.6:
            boards = textures.planks(rng, colors.wood(rng))
            return Material("wood", boards, self.uniform(0.8, 1.3), gloss=0.07)
        if kind < 0.85:
            color = colors.hsv(rng.random(), self.uniform(0.03, 0.4), self.uniform(0.25, 0.75))
            return Material("carpet", textures.carpet(rng, color))
        color = colors.hsv(rng.random(), self.uniform(0, 0.25), self.uniform(0.45, 0.95))
        return Material("tiles", textures.tiles(rng, color), self.uniform(1, 2), gloss=0.08)

    def walls(self, room_type: str) -> tuple[Material, Material]:
        """What most walls are made of, and what one of them is made of."""
        rng, color = self.rng, colors.soft(self.rng)
        common = Material("paint", textures.paint(rng, color), 2)
        if found := self.from_file("wall", (1.0, 2.5)):
            common = found
        if room_type == "bathroom" and self.chance(0.7):
            pale = colors.hsv(rng.random(), self.uniform(0, 0.3), self.uniform(0.7, 0.95))
            common = Material("tiles", textures.tiles(rng, pale), self.uniform(0.6, 1.4), gloss=0.1)
        if self.style.held_out and self.chance(0.5):
            return common, Material("brick", textures.brick(rng), 1.2)
        if not self.chance(0.4):
            return common, common
        if found := self.from_file("wall", (1.0, 2.5)):
            return common, found
        if self.style.plain or self.chance(0.6):
            accent = colors.vivid(rng, (0.2, 0.6), (0.3, 0.8))
            return common, Material("paint", textures.paint(rng, accent), 2)
        darker = np.clip(color * self.uniform(0.75, 0.92), 0, 1)
        return common, self.pattern("wallpaper", color, darker, self.uniform(0.6, 1.5))
