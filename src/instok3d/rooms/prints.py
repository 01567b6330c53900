"""Printed matter: sheets of packages, covers and papers, book spines with titles, posters."""

import numpy as np

from instok3d.rooms import colors, pictures
from instok3d.rooms.colors import Color
from instok3d.rooms.textures import SIZE, Texture, canvas, quantised

CELLS = 4
"""Prints along each side of a sheet."""

CELL = SIZE // CELLS

Picture = np.ndarray


def _ink_on(rng: np.random.Generator, paper: Color) -> Color:
    """A colour that can be read on the paper."""
    if paper.mean() > 0.45:
        return colors.vivid(rng, (0.0, 0.9), (0.03, 0.35))
    return colors.vivid(rng, (0.0, 0.5), (0.75, 1.0))


def write_lines(
    rng: np.random.Generator, picture: Picture, ink: Color, height: int, left: int = 3
) -> None:
    """Fill a picture with lines of words: marks of some height, ragged on the right."""
    rows, columns = picture.shape[:2]
    for y in range(1, rows - height, 2 * height):
        x, end = left, columns - 3 - int(rng.integers(0, max(columns // 3, 1)))
        while x < end:
            width = int(rng.integers(2 * height, 5 * height + 2))
            picture[y : y + height, x : min(x + width, end)] = ink
            x += width + height


def _package(rng: np.random.Generator, picture: Picture) -> None:
    """A bright ground, a title, a picture or badge, and small print."""
    ground = colors.printed(rng)
    picture[:] = ground
    rows = len(picture)
    stripe = int(rng.integers(0, rows - 14))
    if rng.random() < 0.7:
        picture[stripe : stripe + int(rng.integers(8, 24))] = colors.printed(rng)
    y, x = rng.integers(4, rows - 30, 2)
    size = rng.integers(12, 28, 2)
    picture[y : y + size[0], x : x + size[1]] = colors.printed(rng)
    title = int(rng.integers(2, rows - 16))
    write_lines(rng, picture[title : title + 14], _ink_on(rng, ground), int(rng.integers(3, 6)))
    if rng.random() < 0.6:
        low = int(rng.integers(rows // 2, rows - 14))
        write_lines(rng, picture[low:], _ink_on(rng, ground), 1)


def _paper(rng: np.random.Generator, picture: Picture) -> None:
    """A white or tinted page of text, a form, or a drawing."""
    ground = colors.hsv(rng.random(), rng.choice([0.02, 0.05, 0.3]), rng.uniform(0.82, 0.98))
    picture[:] = ground
    if rng.random() < 0.5:
        y, x = rng.integers(4, 30, 2)
        picture[y : y + 22, x : x + 28] = colors.printed(rng)
    if rng.random() < 0.85:
        top = int(rng.integers(0, 30))
        ink = np.full(3, rng.uniform(0.05, 0.5))
        write_lines(rng, picture[top:], ink, int(rng.integers(1, 4)))


def _sheet(rng: np.random.Generator, draw: object) -> Texture:
    assert callable(draw)
    picture = canvas(0.9)
    for row in range(CELLS):
        for column in range(CELLS):
            cell = np.s_[row * CELL : (row + 1) * CELL, column * CELL : (column + 1) * CELL]
            draw(rng, picture[cell])
    return quantised(picture)


def packages(rng: np.random.Generator) -> Texture:
    """CELLS x CELLS packages, covers and labels."""
    return _sheet(rng, _package)


def papers(rng: np.random.Generator) -> Texture:
    """CELLS x CELLS pages."""
    return _sheet(rng, _paper)


def spines(rng: np.random.Generator) -> Texture:
    """A row of books of different heights and widths, with titles along their spines."""
    picture, x = canvas(0.04), 0
    while x < SIZE:
        width, gap = int(rng.integers(5, 26)), int(rng.integers(0, 70))
        color = colors.printed(rng)
        book = picture[gap:, x : x + width - 1]
        book[:] = color
        ink, rows = _ink_on(rng, color), len(book)
        start, end = sorted(rng.integers(8, rows - 8, 2))
        if width > 7:  # the title runs down the spine
            write_lines(rng, book[start:end, 2:-2].swapaxes(0, 1), ink, max(2, width // 5))
        if rng.random() < 0.5:
            y = int(rng.integers(4, rows - 16))
            book[y : y + int(rng.integers(4, 14))] = colors.printed(rng)
        x += width
    return quantised(picture)


def poster(rng: np.random.Generator) -> Texture:
    """A large print: a picture, a title and text, a calendar, or a page of notices."""
    ground = colors.printed(rng)
    picture, ink = canvas(ground), _ink_on(rng, ground)
    kind = rng.random()
    if kind < 0.6:
        image = pictures.art(rng).astype(np.float32) / 255
        top = int(rng.integers(0, 60))
        rows = int(rng.integers(110, SIZE - top))
        picture[top : top + rows] = image[:rows]
        if top > 24:
            write_lines(rng, picture[:top], ink, top // 4, left=12)
        write_lines(rng, picture[top + rows :], ink, 3, left=12)
    elif kind < 0.8:
        picture[:] = 0.92
        picture[:90] = pictures.art(rng)[:90].astype(np.float32) / 255
        for y in range(100, 250, 26):
            picture[y : y + 2] = 0.4
            for x in range(8, 240, 35):
                picture[y + 6 : y + 16, x : x + int(rng.integers(6, 16))] = 0.15
    else:
        for y in range(0, SIZE, 64):
            write_lines(rng, picture[y : y + 40], ink, int(rng.integers(2, 9)), left=10)
    return quantised(picture)
