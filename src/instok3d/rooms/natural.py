"""Materials, colours and light as in photos of real homes: the maker of rooms of level `real`."""

from dataclasses import dataclass

import numpy as np

from instok3d.rooms import colors, fine_textures, pictures, prints
from instok3d.rooms.colors import Color, Number
from instok3d.rooms.materials import Maker, Material, Style


@dataclass(frozen=True, eq=False)
class Kit:
    """Materials that the things of one room share: homes have few, and each takes memory."""

    plastics: tuple[Material, ...]
    ceramics: tuple[Material, ...]
    metals: tuple[Material, ...]
    fabrics: tuple[Material, ...]
    furniture: tuple[Material, ...]
    spines: tuple[Material, ...]
    packages: tuple[Material, ...]
    papers: tuple[Material, ...]


class NaturalMaker(Maker):
    """Draws finely textured materials in the colours of real homes, most of them from a kit."""

    def __init__(self, rng: np.random.Generator, style: Style, kit: Kit | None = None):
        super().__init__(rng, style)
        self.kit = kit

    def make_kit(self) -> Kit:
        """The kit of a room."""
        return Kit(
            plastics=tuple(self.plastic() for _ in range(12)),
            ceramics=tuple(self.ceramic() for _ in range(5)),
            metals=tuple(self.metal() for _ in range(4)),
            fabrics=tuple(self.fabric() for _ in range(7)),
            furniture=tuple(self.furniture() for _ in range(4)),
            spines=tuple(self.books() for _ in range(4)),
            packages=tuple(self.packages() for _ in range(2)),
            papers=(self.papers(),),
        )

    def wood(self) -> Material:
        """Wood with a grain that shows."""
        if found := self.from_file("wood", (0.7, 1.5), 0.06):
            return found
        color = colors.wood(self.rng) * self.uniform(0.45, 1.0)
        texture = fine_textures.wood(self.rng, color)
        return Material("wood", texture, self.uniform(0.8, 1.6), self.uniform(0, 0.15))

    def fabric(self, color: Color | None = None) -> Material:
        """Cloth, plain to printed."""
        if color is None and self.kit and self.chance(0.5):
            return self.choice(self.kit.fabrics)
        if color is None and (found := self.from_file("cloth", (0.3, 0.9))):
            return found
        color = colors.neutral(self.rng) if color is None else color
        if self.style.held_out and self.chance(0.2):
            return self.pattern("fabric", color, colors.neutral(self.rng), self.uniform(0.25, 0.9))
        second = np.clip(color * self.uniform(0.35, 1.6), 0, 1)
        if self.chance(0.3):
            second = colors.neutral(self.rng)
        texture = fine_textures.woven(self.rng, color, second)
        return Material("fabric", texture, self.uniform(0.4, 0.9))

    def metal(self) -> Material:
        """Grey metal from the kit."""
        return self.choice(self.kit.metals) if self.kit else super().metal()

    def plastic(self, color: Color | Number | None = None) -> Material:
        """Plastic: white, black, grey, or strong colours, from the kit."""
        if color is not None:
            return super().plastic(color)
        if self.kit:
            return self.choice(self.kit.plastics)
        return super().plastic(colors.neutral(self.rng, 0.45))

    def ceramic(self, color: Color | Number | None = None) -> Material:
        """Glazed ceramic, half of it white, from the kit."""
        if color is not None:
            return super().ceramic(color)
        if self.kit:
            return self.choice(self.kit.ceramics)
        white = self.chance(0.5)
        return super().ceramic(0.9 if white else colors.neutral(self.rng, 0.5))

    def furniture(self) -> Material:
        """Wood of any darkness, white, black, grey, or painted; mostly from the kit."""
        if self.kit and self.chance(0.75):
            return self.choice(self.kit.furniture)
        if self.chance(0.5):
            return self.wood()
        texture = fine_textures.brushed(self.rng, colors.neutral(self.rng, 0.25))
        return Material("painted wood", texture, gloss=self.uniform(0.02, 0.2))

    def stone(self) -> Material:
        """A worktop, as often dark as pale."""
        if self.style.held_out:
            return super().stone()
        texture = fine_textures.speckled(self.rng, colors.neutral(self.rng, 0.1))
        return Material("granite", texture, gloss=self.uniform(0.05, 0.3))

    def books(self) -> Material:
        """A row of books with titles."""
        if self.kit:
            return self.choice(self.kit.spines)
        return Material("paper", prints.spines(self.rng))

    def label(self) -> Material:
        """The label around a bottle."""
        return self.packages()

    def packages(self) -> Material:
        """A sheet of prints from the kit."""
        return self.choice(self.kit.packages) if self.kit else super().packages()

    def papers(self) -> Material:
        """A sheet of pages from the kit."""
        return self.choice(self.kit.papers) if self.kit else super().papers()

    def kelvin(self) -> float:
        """Colour temperature of a lamp: mostly warm, sometimes neutral or cold."""
        low, high = self.choice([(2700, 3200), (2700, 3600), (3800, 4500), (5000, 6500)])
        return self.uniform(low, high)

    def shade(self, low: Number, high: Number, lit: Number) -> Material:
        """A lamp shade in the colour of its lamp."""
        power = self.uniform(low, high) if self.chance(lit) else 0.0
        color = colors.light_color(self.kelvin()) if power else colors.neutral(self.rng, 0.2)
        light = "lamp" if power else "none"
        return self.plain("fabric", color, 0.02, emission=power, light=light)

    def glow(self, low: Number, high: Number) -> Material:
        """The glass of a ceiling lamp."""
        power, color = self.uniform(low, high), colors.light_color(self.kelvin())
        return self.plain("glass", color, 0.0, emission=power, light="lamp")

    def window_view(self, daylight: Number) -> Material:
        """What windows show, in daylight of 5500 to 9000 K."""
        tint = colors.light_color(self.uniform(5500, 9000))
        if daylight < 0.5:  # the dark outside
            tint = tint * self.uniform(0.05, 0.35)
        view = (pictures.outdoors(self.rng) * tint).astype(np.uint8)
        return Material("glass", view, emission=daylight, light="window")

    def ceiling(self) -> Material:
        """A white or greyish ceiling."""
        white = colors.hsv(0.1, self.uniform(0, 0.08), self.uniform(0.65, 0.95))
        return Material("paint", fine_textures.plaster(self.rng, white), 2)

    def floor(self, room_type: str) -> Material:
        """Boards, carpet, tiles or stone, with the detail of these."""
        if found := self.from_file("floor", (0.9, 2.2), 0.1):
            return found
        rng, kind = self.rng, self.rng.random()
        if self.style.held_out and self.chance(0.4):
            return super().floor(room_type)
        if room_type in ("bathroom", "kitchen"):
            kind = kind * 0.5 + 0.5
        gloss = self.uniform(0.03, 0.2)
        if kind < 0.4:
            color = colors.wood(rng) * self.uniform(0.4, 1.0)
            return Material("wood", fine_textures.boards(rng, color), self.uniform(0.9, 1.5), gloss)
        if kind < 0.72:
            first, second = colors.dull(rng), colors.dull(rng)
            yarn = fine_textures.carpet(rng, first, np.clip(0.5 * (first + second), 0, 1))
            return Material("carpet", yarn, self.uniform(0.7, 1.3))
        if kind < 0.92:
            tiles = fine_textures.mosaic(rng, colors.neutral(rng, 0.2), self.uniform(0.02, 0.12))
            return Material("tiles", tiles, self.uniform(1.2, 2.4), gloss)
        stone = fine_textures.speckled(rng, colors.neutral(rng, 0.1))
        return Material("linoleum", stone, self.uniform(0.8, 1.6), gloss)

    def walls(self, room_type: str) -> tuple[Material, Material]:
        """Plaster in any colour, wallpaper with a small motif, or tiles."""
        if self.style.held_out and self.chance(0.5):
            return super().walls(room_type)
        common = self._wall(room_type)
        return common, (self._wall(room_type) if self.chance(0.4) else common)

    def _wall(self, room_type: str) -> Material:
        if found := self.from_file("wall", (1.0, 2.5)):
            return found
        rng, color = self.rng, colors.interior(self.rng)
        wet = {"bathroom": 0.75, "kitchen": 0.3}.get(room_type, 0.0)
        if self.chance(wet):
            tiles = fine_textures.mosaic(rng, color, self.uniform(0.01, 0.08))
            return Material("tiles", tiles, self.uniform(0.8, 1.8), gloss=0.12)
        if self.chance(0.2):
            second = np.clip(color * self.uniform(0.6, 1.25), 0, 1)
            paper = fine_textures.wallpaper(rng, color, second)
            return Material("wallpaper", paper, self.uniform(0.7, 1.4))
        return Material("paint", fine_textures.plaster(rng, color), 2)
