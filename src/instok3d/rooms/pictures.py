"""Pictures that fit a whole surface: art, screens, window views, book spines, clock faces."""

import numpy as np

from instok3d.rooms import colors
from instok3d.rooms.colors import Number
from instok3d.rooms.textures import SIZE, Texture, X, Y, canvas, framed, noise, quantised


def _horizon(rng: np.random.Generator, low: Number, high: Number, roughness: Number) -> np.ndarray:
    """Height of a ridge for every column, repeated over the rows."""
    ridge = rng.uniform(low, high) + roughness * noise(rng, 3)[0]
    return np.broadcast_to(ridge, (SIZE, SIZE))


def _landscape(rng: np.random.Generator, palette: np.ndarray) -> np.ndarray:
    ridge = _horizon(rng, 0.35, 0.65, 0.06)
    down = Y[..., None]
    sky = palette[0] * (1 - down * 0.5) + 0.3 * down
    picture = np.where((ridge > Y)[..., None], sky, palette[1] * (0.4 + 0.6 * down))
    picture[(X - rng.random()) ** 2 + (Y - 0.25) ** 2 < 0.01] = [1, 0.95, 0.7]
    picture[ridge + 0.12 + 0.05 * noise(rng, 3)[1] < Y] = palette[2] * 0.7
    return picture


def _blobs(rng: np.random.Generator, palette: np.ndarray) -> np.ndarray:
    level = np.clip(((noise(rng, 3.2) + 2) / 4 * 5).astype(int), 0, 5)
    return palette[level] * (0.8 + 0.2 * np.tanh(noise(rng, 3.2)))[..., None]


def _rectangles(rng: np.random.Generator, palette: np.ndarray) -> np.ndarray:
    picture = canvas(0.93)
    for _ in range(9):
        (x, y), (w, h) = rng.integers(0, 220, 2), rng.integers(20, 120, 2)
        picture[y : y + h, x : x + w] = palette[rng.integers(6)]
        picture[y : y + h, x : x + 4] = picture[y : y + 4, x : x + w] = 0.05
    return picture


def _circles(rng: np.random.Generator, palette: np.ndarray) -> np.ndarray:
    picture = canvas(palette[0])
    for _ in range(10):
        distance2 = (X - rng.random()) ** 2 + (Y - rng.random()) ** 2
        picture[distance2 < rng.uniform(0.004, 0.06)] = palette[rng.integers(6)]
    return picture


def _portrait(rng: np.random.Generator, palette: np.ndarray) -> np.ndarray:
    picture = palette[0] * (0.6 + 0.4 * Y)[..., None]
    skin = colors.hsv(0.07, 0.45, rng.uniform(0.4, 0.95))
    shapes = (
        (1.05, 0.34, 0.42, palette[1]),
        (0.45, 0.17, 0.23, skin),
        (0.28, 0.2, 0.14, palette[3] * 0.3),
    )
    for center, half_width, half_height, color in shapes:
        inside = ((X - 0.5) / half_width) ** 2 + ((Y - center) / half_height) ** 2 < 1
        picture[inside] = color
    return picture


def art(rng: np.random.Generator) -> Texture:
    """A picture for the wall, some with a white mount."""
    palette = np.array([colors.vivid(rng, (0.1, 0.9), (0.15, 1)) for _ in range(6)])
    draw = (_landscape, _blobs, _rectangles, _circles, _portrait)[rng.integers(5)]
    picture, mount = draw(rng, palette), int(rng.integers(0, 24))
    return framed(picture, mount, 0.95) if mount > 6 else quantised(picture)


def screen(rng: np.random.Generator) -> Texture:
    """What a screen shows: nothing, a picture, or lines of text in a window."""
    kind = rng.random()
    if kind < 0.4:
        return quantised(canvas(np.array([0.02, 0.02, 0.025])))
    if kind < 0.7:
        return art(rng)
    picture = canvas(rng.uniform(0.05, 0.95))
    picture[:14] = colors.vivid(rng)
    for y in range(24, 240, 9):
        x, end = 10, int(rng.integers(60, 245))
        while x < end:
            width = int(rng.integers(5, 25))
            picture[y : y + 4, x : x + width] = colors.vivid(rng, (0, 0.8), (0.2, 0.8))
            x += width + 4
    return quantised(picture)


def outdoors(rng: np.random.Generator) -> Texture:
    """Sky above green, as seen through a window."""
    sky = colors.hsv(0.58, rng.uniform(0.05, 0.35), 1.0)
    ridge = _horizon(rng, 0.45, 0.8, 0.05)
    green = colors.hsv(rng.uniform(0.2, 0.38), rng.uniform(0.2, 0.5), rng.uniform(0.4, 0.75))
    land = green * (1 + 0.25 * noise(rng, 1.5))[..., None]
    return quantised(np.where((ridge > Y)[..., None], sky * (0.9 + 0.1 * Y[..., None]), land))


def book_spines(rng: np.random.Generator) -> Texture:
    """A row of book spines of different heights, dark between and above them."""
    picture, x = canvas(0.08), 0
    while x < SIZE:
        width, gap = int(rng.integers(8, 24)), int(rng.integers(0, 50))
        picture[gap:, x : x + width - 1] = colors.vivid(rng, (0.1, 0.9), (0.15, 0.95))
        y, label = int(rng.integers(60, 150)), int(rng.integers(5, 40))
        picture[y : y + label, x + 2 : x + width - 3] = rng.uniform(0.1, 0.95)
        x += width
    return quantised(picture)


def keyboard(rng: np.random.Generator) -> Texture:
    """Five rows of keys, lighter or darker than their bed."""
    bed = rng.uniform(0.03, 0.9)
    picture = canvas(bed)
    key = bed - 0.15 if bed > 0.5 else bed + 0.3
    for row in range(5):
        for column in range(14):
            y, x = 10 + row * 48, 6 + column * 18
            picture[y : y + 38, x : x + 13] = key
    return quantised(picture)


def piano_keys(rng: np.random.Generator) -> Texture:
    """White keys with black ones in groups."""
    picture = canvas(0.95)
    for key in range(50):
        if key % 7 not in (2, 6):
            x = int(SIZE * (key + 0.7) / 50)
            picture[:150, x : x + 3] = 0.03
    return quantised(picture)


def clock_face(rng: np.random.Generator) -> Texture:
    """Twelve marks and two hands at any time."""
    paper = rng.choice([0.95, 0.1])
    picture, ink = canvas(paper), 0.05 if paper > 0.5 else 0.9
    distance, angle = np.hypot(X - 0.5, Y - 0.5), np.arctan2(Y - 0.5, X - 0.5)
    mark = np.abs((angle / (np.pi / 6) + 0.5) % 1 - 0.5) < 0.12
    picture[(distance > 0.40) & (distance < 0.46) & mark] = ink
    for length, width in ((0.25, 0.03), (0.36, 0.02)):
        turn = rng.uniform(-np.pi, np.pi)
        along = (X - 0.5) * np.cos(turn) + (Y - 0.5) * np.sin(turn)
        aside = (Y - 0.5) * np.cos(turn) - (X - 0.5) * np.sin(turn)
        picture[(along > 0) & (along < length) & (abs(aside) < width / 2)] = ink
    return quantised(picture)


def whiteboard(rng: np.random.Generator) -> Texture:
    """A white board with a few strokes of a pen."""
    picture = canvas(0.93)
    for _ in range(int(rng.integers(0, 8))):
        y, x = rng.integers(20, 220, 2)
        length = int(rng.integers(20, 110))
        picture[y : y + 3, x // 2 : x // 2 + length] = colors.vivid(rng, (0.5, 1), (0.1, 0.7))
    return quantised(picture)


def mirror(rng: np.random.Generator) -> Texture:
    """A painted mirror: a pale gradient."""
    shade = np.linspace(0.75, 0.45, SIZE)[:, None, None]
    return quantised(canvas(np.array([0.95, 1, 1])) * shade)
