"""Procedural tileable textures: sRGB uint8 pictures, row 0 at the top."""

from functools import lru_cache

import numpy as np
import scipy.fft
from jaxtyping import Float, UInt8
from PIL import Image

from instok3d.rooms import colors
from instok3d.rooms.colors import Color, Number

SIZE = 256
"""Texels along each side."""

Texture = UInt8[np.ndarray, "256 256 3"]
Noise = Float[np.ndarray, "256 256"]

_FREQ_X, _FREQ_Y = np.meshgrid(
    np.arange(SIZE // 2 + 1, dtype=np.float32), (np.fft.fftfreq(SIZE) * SIZE).astype(np.float32)
)
X, Y = np.meshgrid(*[(np.arange(SIZE, dtype=np.float32) + 0.5) / SIZE] * 2)
"""Position of every texel in [0, 1]: x to the right, y downwards."""


@lru_cache(maxsize=256)
def _field(index: int, falloff: Number, across: Number, down: Number) -> Noise:
    """One of the noise fields that `noise` shifts and mirrors."""
    frequency = np.sqrt((_FREQ_X * across) ** 2 + (_FREQ_Y * down) ** 2)
    frequency[0, 0] = 1
    gain = frequency ** np.float32(-falloff / 2)
    gain[0, 0] = 0
    gain[frequency < 1] = 0
    rng = np.random.default_rng([index, round(falloff * 100), round(down * 100)])
    white = rng.standard_normal((SIZE, SIZE), dtype=np.float32)
    spectrum = np.asarray(scipy.fft.rfft2(white)) * gain
    field = np.asarray(scipy.fft.irfft2(spectrum, s=(SIZE, SIZE)), np.float32)
    return field / field.std()


def noise(
    rng: np.random.Generator, falloff: Number = 2.0, across: Number = 1.0, down: Number = 1.0
) -> Noise:
    """Tileable noise with power ~ frequency^-falloff, mean 0, deviation 1; long where < 1.

    A shifted and mirrored copy of one of 16 fields: a fresh transform each time would cost more
    than rendering the room.
    """
    field = _field(int(rng.integers(16)), falloff, across, down)
    mirror = field[:, ::-1] if rng.random() < 0.5 else field
    return np.roll(mirror, rng.integers(SIZE, size=2), axis=(0, 1))


def quantised(picture: np.ndarray) -> Texture:
    """A texture of a picture in [0, 1]; what lies outside is clamped."""
    scaled = np.asarray(picture, np.float32) * np.float32(255) + np.float32(0.5)
    return np.clip(scaled, 0, 255, out=scaled).astype(np.uint8)


def resampled(picture: UInt8[np.ndarray, "height width 3"], factor: Color) -> Texture:
    """A texture of a whole picture of any size, stretched to a square, its colours multiplied."""
    square = Image.fromarray(picture).resize((SIZE, SIZE), Image.Resampling.BOX)
    return quantised(np.asarray(square, np.float32) / 255 * np.asarray(factor, np.float32))


def uniform(color: Color) -> Texture:
    """One colour, stored once."""
    return np.broadcast_to(quantised(canvas(color))[:1, :1], (SIZE, SIZE, 3))


def canvas(color: Color | Number) -> Float[np.ndarray, "256 256 3"]:
    """A picture of one colour (a number is a grey), to draw on."""
    return np.ones((SIZE, SIZE, 3), np.float32) * np.asarray(color, np.float32)


def shaded(color: np.ndarray, shade: np.ndarray) -> Texture:
    """A colour times 1 + shade."""
    shade = np.asarray(shade, np.float32)[..., None]
    return quantised(np.asarray(color, np.float32) * (1 + shade))


def plain(rng: np.random.Generator, color: Color, unevenness: Number = 0.01) -> Texture:
    """One colour, slightly uneven."""
    if unevenness == 0:
        return quantised(canvas(color))
    return shaded(color, unevenness * noise(rng, 1.5))


def paint(rng: np.random.Generator, color: Color) -> Texture:
    """A painted wall."""
    return shaded(color, 0.012 * noise(rng, 2) + 0.006 * noise(rng, 0.4))


def wood(rng: np.random.Generator, color: Color) -> Texture:
    """Grain that runs up."""
    grain = noise(rng, 2.2, down=0.08 if rng.random() < 0.5 else 0.05)
    rings = np.sin(2 * np.pi * (X * rng.integers(3, 8)) + 1.2 * grain)
    return shaded(color, 0.10 * rings + 0.05 * grain + 0.05 * noise(rng, 0.8, down=0.03))


def planks(rng: np.random.Generator, color: Color) -> Texture:
    """Floor boards with joints."""
    columns, rows = int(rng.integers(4, 9)), int(rng.integers(1, 3))
    column = np.floor(X * columns).astype(int)
    along = Y + rng.random(columns)[column]
    row = np.floor(along * rows).astype(int) % rows
    tone = rng.normal(0, 0.12, (columns, rows))[column, row]
    hue = rng.normal(0, 0.03, (columns, rows, 3))[column, row]
    grain = 0.07 * noise(rng, 2, down=0.06) + 0.04 * noise(rng, 0.8, down=0.03)
    boards = color * (1 + tone + grain)[..., None] * (1 + hue)
    joint = ((X * columns) % 1 < 0.035) | ((along * rows) % 1 < 0.008)
    boards[joint] *= 0.55
    return quantised(boards)


def tiles(rng: np.random.Generator, color: Color, second: Color | None = None) -> Texture:
    """Square tiles with grout, chequered when a second colour is given, sometimes shifted rows."""
    count = 2 * int(rng.integers(1, 4))
    shift = (np.floor(Y * count) % 2) * 0.5 if rng.random() < 0.3 else 0.0
    column = np.floor(X * count + shift).astype(int) % count
    row = np.floor(Y * count).astype(int)
    odd = ((column + row) % 2)[..., None]
    base = color * (1 - odd) + (color if second is None else second) * odd
    tone = rng.normal(0, 0.03, (count, count))[column, row]
    surface = base * (1 + tone + 0.04 * noise(rng, 2.2))[..., None]
    grout = ((X * count + shift) % 1 < 0.025) | ((Y * count) % 1 < 0.025)
    surface[grout] = rng.uniform(0.3, 0.8)
    return quantised(surface)


def brick(rng: np.random.Generator) -> Texture:
    """A brick wall, bare or painted."""
    color = colors.hsv(
        rng.choice([0.02, 0.04, 0.08, 0.0]), rng.uniform(0.2, 0.55), rng.uniform(0.4, 0.85)
    )
    row = np.floor(Y * 12).astype(int)
    along = X * 3 + (row % 2) * 0.5
    tone = rng.normal(0, 0.12, (12, 3))[row, np.floor(along).astype(int) % 3]
    surface = color * (1 + tone + 0.08 * noise(rng, 1.5))[..., None]
    surface[(along % 1 < 0.04) | ((Y * 12) % 1 < 0.1)] = rng.uniform(0.5, 0.8)
    return quantised(surface)


def fabric(rng: np.random.Generator, color: Color) -> Texture:
    """Woven cloth."""
    threads = int(rng.integers(24, 64))
    weave = np.sin(2 * np.pi * threads * X) * np.sin(2 * np.pi * threads * Y)
    return shaded(color, 0.06 * weave + 0.05 * noise(rng, 0.6) + 0.05 * noise(rng, 2))


def carpet(rng: np.random.Generator, color: Color) -> Texture:
    """A fitted carpet."""
    return shaded(color, 0.12 * noise(rng, 0.5) + 0.05 * noise(rng, 2))


def granite(rng: np.random.Generator, color: Color) -> Texture:
    """Speckled stone."""
    return shaded(color, 0.2 * np.tanh(noise(rng, 0.3)) + 0.06 * noise(rng, 2))


def marble(rng: np.random.Generator, color: Color) -> Texture:
    """Veined stone."""
    veins = np.abs(np.sin(3 * noise(rng, 2.6) + 2 * noise(rng, 3)))
    return shaded(color, 0.18 * veins**0.4 - 0.18)


def concrete(rng: np.random.Generator, value: Number) -> Texture:
    """Bare concrete."""
    color = np.array([value, value, value * 0.98])
    return shaded(color, 0.05 * noise(rng, 1.8) + 0.03 * noise(rng, 0.5))


def _stripes(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.sin(2 * np.pi * count * X) > rng.uniform(-0.6, 0.6)


def _checks(rng: np.random.Generator, count: int) -> np.ndarray:
    return (np.floor(X * count * 2) + np.floor(Y * count * 2)) % 2


def _dots(rng: np.random.Generator, count: int) -> np.ndarray:
    radius2 = ((X * count) % 1 - 0.5) ** 2 + ((Y * count) % 1 - 0.5) ** 2
    return radius2 < rng.uniform(0.03, 0.12)


def _waves(rng: np.random.Generator, count: int) -> np.ndarray:
    down = np.sin(2 * np.pi * count * Y)
    field = 0.5 + 0.5 * np.sin(2 * np.pi * count * X + 2 * down) * down
    return np.clip((field - 0.4) * 5, 0, 1)


def _plaid(rng: np.random.Generator, count: int) -> np.ndarray:
    width = rng.uniform(0.1, 0.3)
    return 0.5 * ((X * count) % 1 < width) + 0.5 * ((Y * count) % 1 < width)


def _zigzag(rng: np.random.Generator, count: int) -> np.ndarray:
    teeth = 0.5 * np.abs(((X * count) % 1) * 2 - 1)
    return np.sin(2 * np.pi * (count * Y + teeth)) > 0


PATTERNS = {"stripes": _stripes, "checks": _checks, "dots": _dots, "waves": _waves,
            "plaid": _plaid, "zigzag": _zigzag}  # fmt: skip


def pattern(rng: np.random.Generator, first: Color, second: Color, kind: str) -> Texture:
    """Two colours in one of PATTERNS."""
    amount = np.asarray(PATTERNS[kind](rng, int(rng.integers(2, 9))), float)[..., None]
    return shaded(first * (1 - amount) + second * amount, 0.03 * noise(rng, 0.8))


def rug(rng: np.random.Generator) -> Texture:
    """A whole rug with its border: cloth, rings, or a rosette."""
    palette = np.array([colors.cloth(rng) for _ in range(4)])
    kind = rng.integers(4)
    if kind == 0:
        picture = (
            pattern(rng, palette[0], palette[1], rng.choice(["stripes", "checks", "plaid"])) / 255.0
        )
    elif kind == 1:
        picture = fabric(rng, palette[0]) / 255.0
    elif kind == 2:
        distance = np.maximum(abs(X - 0.5), abs(Y - 0.5)) * 2
        picture = palette[(distance * rng.integers(3, 9)).astype(int) % 4]
    else:
        distance, angle = np.hypot(X - 0.5, Y - 0.5) * 2, np.arctan2(Y - 0.5, X - 0.5)
        petals = 0.3 * np.sin(angle * rng.integers(4, 12))
        picture = palette[((distance * 5 + petals) % 4).astype(int) % 4]
    picture = picture * (1 + 0.08 * noise(rng, 0.5))[..., None]
    return framed(picture, int(rng.integers(5, 20)), palette[3])


def framed(picture: np.ndarray, width: int, color: Color | Number) -> Texture:
    """A texture of a picture whose outermost `width` texels take the colour."""
    picture[:width] = picture[-width:] = color
    picture[:, :width] = picture[:, -width:] = color
    return quantised(picture)
