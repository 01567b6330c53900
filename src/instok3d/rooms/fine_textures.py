"""Procedural textures with detail of centimetres, which pictures of 128 pixels still show."""

from functools import lru_cache

import numpy as np
import scipy.fft

from instok3d.rooms.colors import Color, Number
from instok3d.rooms.textures import SIZE, Noise, Texture, X, Y, noise, quantised, shaded


@lru_cache(maxsize=64)
def _band_field(index: int, cycles: int, along: Number) -> Noise:
    rows = np.fft.fftfreq(SIZE)[:, None] * SIZE * along
    columns = np.arange(SIZE // 2 + 1)[None]
    octaves = np.log2(np.maximum(np.hypot(rows, columns), 0.5) / cycles)
    white = np.random.default_rng([index, cycles]).standard_normal((SIZE, SIZE))
    spectrum = np.asarray(scipy.fft.rfft2(white)) * np.exp(-2 * octaves**2)
    spectrum[0, 0] = 0
    field = np.asarray(scipy.fft.irfft2(spectrum, s=(SIZE, SIZE)), np.float32)
    return field / field.std()


def band(rng: np.random.Generator, cycles: int, along: Number = 1.0) -> Noise:
    """Tileable noise with about `cycles` blobs across the tile; long upwards where along > 1."""
    field = _band_field(int(rng.integers(8)), cycles, along)
    return np.roll(field, rng.integers(SIZE, size=2), axis=(0, 1))


def plaster(rng: np.random.Generator, color: Color) -> Texture:
    """A painted wall with roller marks, stains and, often, a rough surface."""
    rough = rng.uniform(0.0, 0.03) * band(rng, int(rng.choice([24, 40, 64])))
    return shaded(color, rough + 0.015 * noise(rng, 2.6) + 0.008 * noise(rng, 0.4))


def wallpaper(rng: np.random.Generator, first: Color, second: Color) -> Texture:
    """A small motif: flowers, lattice, fine stripes or leaves, a few centimetres wide."""
    count, kind = int(rng.integers(6, 18)), rng.integers(4)
    u, v = 2 * np.pi * count * X, 2 * np.pi * count * Y
    if kind == 0:
        field = np.sin(u) * np.sin(v) + 0.5 * np.sin(2 * u + v) * np.sin(v)
    elif kind == 1:
        field = np.abs(np.sin((u + v) / 2)) + np.abs(np.sin((u - v) / 2)) - 0.6
        field = np.where((np.sin(u) > 0.8) & (np.sin(v) > 0.8), -1, field)
    elif kind == 2:
        field = np.sin(u) + 0.6 * np.sin(3 * u + rng.uniform(0, 6)) + rng.uniform(-0.4, 0.4)
    else:
        field = band(rng, count) + rng.uniform(-0.8, 0.2)
    amount = np.clip(0.5 + 3 * field, 0, 1)[..., None]
    return shaded(first * (1 - amount) + second * amount, 0.02 * noise(rng, 0.8))


def _grain(rng: np.random.Generator, strength: Number) -> Noise:
    """Dark streaks and broad bands that run up."""
    streaks = np.minimum(band(rng, int(rng.choice([20, 32, 48])), 9.0), 0.5)
    return strength * (0.55 * streaks + 0.5 * noise(rng, 2.4, down=14))


def wood(rng: np.random.Generator, color: Color) -> Texture:
    """Wood from even to strongly figured."""
    return shaded(color, _grain(rng, rng.uniform(0.06, 0.26)) + 0.03 * noise(rng, 0.8, down=30))


def _turned(picture: np.ndarray, odd: np.ndarray) -> np.ndarray:
    return np.where(odd, picture.T, picture)


def boards(rng: np.random.Generator, color: Color) -> Texture:
    """A floor of narrow boards, or of parquet blocks that lie across each other."""
    grain = _grain(rng, rng.uniform(0.08, 0.22))
    if rng.random() < 0.3:  # blocks of 2 to 5 strips, every second block turned
        blocks, strips = 2 * int(rng.integers(2, 4)), int(rng.integers(3, 6))
        odd = (np.floor(X * blocks) + np.floor(Y * blocks)) % 2 > 0
        strip = np.where(odd, np.floor(Y * blocks * strips), np.floor(X * blocks * strips))
        block = np.floor(X * blocks) * 7 + np.floor(Y * blocks) * 13
        tone = rng.normal(0, 0.13, 1024)[(strip * 5 + block * 3).astype(int) % 1024]
        across = np.where(odd, Y, X) * blocks * strips % 1
        joint = (across < 0.1) | (X * blocks % 1 < 0.02) | (Y * blocks % 1 < 0.02)
        grain = _turned(grain, odd)
    else:
        columns, rows = int(rng.integers(6, 15)), int(rng.integers(1, 4))
        column = np.floor(X * columns).astype(int)
        along = Y + rng.random(columns)[column]
        row = np.floor(along * rows).astype(int) % rows
        tone = rng.normal(0, rng.uniform(0.05, 0.2), (columns, rows))[column, row]
        joint = ((X * columns) % 1 < 0.06) | ((along * rows) % 1 < 0.012)
    picture = np.asarray(color) * (1 + tone + grain)[..., None]
    picture[joint] *= rng.uniform(0.35, 0.75)
    return quantised(picture)


def carpet(rng: np.random.Generator, color: Color, second: Color) -> Texture:
    """A carpet of mottled yarn, of uneven stripes, or with a small repeat."""
    kind = rng.random()
    mottled = rng.uniform(0.05, 0.25) * band(rng, int(rng.choice([32, 48, 72])))
    if kind < 0.5:
        return shaded(color, mottled + 0.05 * noise(rng, 2))
    if kind < 0.75:
        widths = rng.integers(2, 9, SIZE)
        tones = np.repeat(rng.random(SIZE), widths)[:SIZE, None]
        return shaded(color * (1 - tones) + second * tones + 0 * Y[..., None], mottled)
    count = int(rng.integers(6, 16))
    dots = ((X * count) % 1 - 0.5) ** 2 + ((Y * count) % 1 - 0.5) ** 2
    amount = (dots < rng.uniform(0.03, 0.15))[..., None]
    return shaded(color * (1 - amount) + second * amount, mottled)


def mosaic(rng: np.random.Generator, color: Color, contrast: Number) -> Texture:
    """Tiles from small to large with grout, each of its own shade."""
    count = 2 * int(rng.integers(2, 8))
    row = np.floor(Y * count).astype(int)
    shift = (row % 2) * (0.5 if rng.random() < 0.4 else 0.0)
    wide = int(rng.choice([1, 2]))  # 2: metro tiles
    along = X * count / wide + shift
    column = np.floor(along).astype(int) % (count // wide)
    tone = rng.normal(0, contrast, (count, count))[column, row]
    picture = color * (1 + tone + 0.03 * noise(rng, 2.2))[..., None]
    joint = rng.uniform(0.03, 0.07)
    picture[(along % 1 < joint / wide) | (Y * count % 1 < joint)] = rng.uniform(0.15, 0.85)
    return quantised(picture)


def woven(rng: np.random.Generator, color: Color, second: Color) -> Texture:
    """Cloth: nearly plain, tweed, ribs, checks, or a printed pattern."""
    kind, soft = rng.random(), 0.05 * noise(rng, 2)
    if kind < 0.4:
        return shaded(color, rng.uniform(0.03, 0.1) * band(rng, 48) + soft)
    if kind < 0.6:
        amount = np.clip(0.5 + band(rng, int(rng.choice([40, 64]))), 0, 1)
    elif kind < 0.75:
        amount = 0.5 + 0.5 * np.sin(2 * np.pi * int(rng.integers(8, 28)) * X)
    elif kind < 0.88:
        count, width = int(rng.integers(3, 14)), rng.uniform(0.15, 0.5)
        amount = 0.5 * ((X * count) % 1 < width) + 0.5 * ((Y * count) % 1 < width)
    else:
        amount = np.clip(3 * band(rng, int(rng.integers(4, 14))) - rng.uniform(-1, 2), 0, 1)
    amount = amount[..., None]
    return shaded(color * (1 - amount) + second * amount, soft + 0.03 * noise(rng, 0.6))


def speckled(rng: np.random.Generator, color: Color) -> Texture:
    """Stone or terrazzo with grains of a centimetre or two."""
    grains = np.tanh(2 * band(rng, int(rng.choice([24, 40, 64]))))
    return shaded(color, rng.uniform(0.05, 0.35) * grains + 0.08 * noise(rng, 2))


def brushed(rng: np.random.Generator, color: Color) -> Texture:
    """Worn paint, metal or plastic: faint streaks and smudges."""
    return shaded(color, 0.015 * band(rng, 24, 6.0) + 0.03 * noise(rng, 2.4))
