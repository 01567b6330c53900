"""Colours: drawing plausible ones, and naming the colour that a texture shows."""

import colorsys

import numpy as np
from jaxtyping import Float

Number = float | int
"""A scalar; whole ones may be written without a point."""

Color = Float[np.ndarray, " 3"]
"""sRGB in [0, 1]."""

WOODS = (
    (0.09, 0.45, 0.62), (0.08, 0.55, 0.45), (0.07, 0.6, 0.32), (0.1, 0.3, 0.78),
    (0.05, 0.55, 0.38), (0.11, 0.35, 0.70), (0.06, 0.4, 0.2), (0.085, 0.22, 0.86),
)  # fmt: skip
"""Hue, saturation, value of common woods."""


def hsv(hue: Number, saturation: Number, value: Number) -> Color:
    """The sRGB colour; the hue wraps, the others are clamped to [0, 1]."""
    clamp = [min(max(float(x), 0.0), 1.0) for x in (saturation, value)]
    return np.array(colorsys.hsv_to_rgb(float(hue) % 1, *clamp))


def vivid(
    rng: np.random.Generator,
    saturation: tuple[Number, Number] = (0.15, 0.85),
    value: tuple[Number, Number] = (0.25, 0.95),
) -> Color:
    """Any hue, saturation and value from ranges."""
    return hsv(rng.random(), rng.uniform(*saturation), rng.uniform(*value))


def wood(rng: np.random.Generator) -> Color:
    """A wood's colour."""
    h, s, v = WOODS[rng.integers(len(WOODS))]
    return hsv(h + rng.normal(0, 0.008), s * rng.uniform(0.8, 1.15), v * rng.uniform(0.85, 1.12))


def soft(rng: np.random.Generator) -> Color:
    """A colour that walls and painted furniture have: mostly pale, sometimes stronger."""
    kind = rng.random()
    if kind < 0.45:
        hue = rng.choice([0.08, 0.1, 0.12, 0.6, 0.55])
        return hsv(hue, rng.uniform(0.02, 0.2), rng.uniform(0.75, 0.97))
    if kind < 0.75:
        return vivid(rng, (0.08, 0.3), (0.65, 0.95))
    return vivid(rng, (0.25, 0.55), (0.45, 0.85))


def cloth(rng: np.random.Generator) -> Color:
    """A colour that fabrics have: a third of them nearly grey."""
    if rng.random() < 0.3:
        hue = rng.choice([0.08, 0.1, 0.6])
        return hsv(hue, rng.uniform(0, 0.15), rng.uniform(0.15, 0.9))
    return vivid(rng, (0.2, 0.8), (0.2, 0.85))


def homely(
    rng: np.random.Generator, saturation: tuple[Number, Number], value: tuple[Number, Number]
) -> Color:
    """A stronger colour of homes: red to yellow, green or blue, seldom any other."""
    hue = rng.choice([0.0, 0.04, 0.08, 0.12, 0.25, 0.38, 0.55, 0.6, 0.64]) + rng.normal(0, 0.02)
    if rng.random() < 0.1:
        hue = rng.random()
    return hsv(hue, rng.uniform(*saturation), rng.uniform(*value))


def interior(rng: np.random.Generator) -> Color:
    """A colour that walls of real homes have: white, grey, dull, or strong."""
    kind = rng.random()
    if kind < 0.36:
        return hsv(rng.choice([0.08, 0.11, 0.13, 0.6]), rng.uniform(0, 0.1), rng.uniform(0.8, 0.97))
    if kind < 0.6:
        return hsv(rng.choice([0.1, 0.6]), rng.uniform(0, 0.12), rng.uniform(0.35, 0.78))
    if kind < 0.82:
        return homely(rng, (0.06, 0.28), (0.4, 0.85))
    return homely(rng, (0.25, 0.6), (0.25, 0.65))


def neutral(rng: np.random.Generator, strong: Number = 0.25) -> Color:
    """White, grey, black or beige, or a stronger colour as often as said."""
    kind = rng.random()
    if kind < strong:
        return homely(rng, (0.2, 0.8), (0.15, 0.8))
    value = rng.choice([rng.uniform(0.03, 0.15), rng.uniform(0.2, 0.6), rng.uniform(0.75, 0.96)])
    return hsv(rng.choice([0.07, 0.1, 0.6, 0.62]), rng.uniform(0, 0.2), value)


def dull(rng: np.random.Generator) -> Color:
    """A colour of carpets and heavy cloth: grey, brown, or faint."""
    if rng.random() < 0.4:
        return hsv(rng.choice([0.08, 0.1, 0.6]), rng.uniform(0, 0.15), rng.uniform(0.08, 0.75))
    return homely(rng, (0.08, 0.45), (0.12, 0.65))


def printed(rng: np.random.Generator) -> Color:
    """A colour of printed matter: white, black, or strong."""
    kind = rng.random()
    if kind < 0.35:
        return hsv(rng.random(), rng.uniform(0, 0.08), rng.uniform(0.85, 0.98))
    if kind < 0.5:
        return hsv(rng.random(), rng.uniform(0, 0.4), rng.uniform(0.03, 0.2))
    return vivid(rng, (0.4, 0.95), (0.3, 0.95))


def light_color(kelvin: Number) -> Color:
    """The colour of a black body of 1000 to 40000 K, the brightest channel 1.

    Tanner Helland's fit of the CIE 1964 colour matching functions in sRGB.
    """
    t = kelvin / 100
    red = 1.0 if t <= 66 else 1.292936 * (t - 60) ** -0.1332047592
    green = 0.390082 * np.log(t) - 0.631841 if t <= 66 else 1.129891 * (t - 60) ** -0.0755148492
    blue = 1.0 if t >= 66 else 0.543207 * np.log(t - 10) - 1.196254
    color = np.clip([red, green, blue], 0.02, 1)
    return color / color.max()


def color_name(color: Color) -> str:
    """The basic English name of an sRGB colour (one of 13)."""
    hue, saturation, value = colorsys.rgb_to_hsv(*(float(x) for x in color))
    if value < 0.16:
        return "black"
    if saturation < 0.12 or saturation * value < 0.06:
        return "white" if value > 0.78 else "grey" if value > 0.2 else "black"
    degrees = hue * 360
    if degrees < 55 and degrees >= 16 and saturation < 0.38 and value > 0.62:
        return "beige"
    if degrees < 50 and degrees >= 10 and value < 0.68:
        return "brown"
    if (degrees >= 315 or degrees < 16) and saturation < 0.5 and value > 0.6:
        return "pink"
    edges = (16, "red"), (45, "orange"), (68, "yellow"), (160, "green"), (195, "turquoise"), \
        (255, "blue"), (295, "purple"), (335, "pink"), (361, "red")  # fmt: skip
    return next(name for edge, name in edges if degrees < edge)
