"""Names of the colours that pictures show, which are seldom those of the materials alone."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int, UInt8

PALETTE = {
    "white": ("f4f4f4", "d4d4d4", "dcdad4", "d4dae0"),
    "grey": ("989898", "747474", "545454"),
    "black": ("080808", "262626"),
    "red": ("d02020", "a01818", "701010", "c04038", "4c1014"),
    "orange": ("e88020", "d86818", "f0a050", "c06020"),
    "yellow": ("f0d830", "d8b820", "f0e490", "a89020"),
    "green": ("30a030", "206020", "78a858", "506838", "b0d0a0", "304828", "183018", "80a090"),
    "turquoise": ("30b0b0", "208080", "90d0c8", "105858"),
    "blue": ("2050c0", "102870", "5880c0", "90b4dc", "405878", "182440", "8090b0"),
    "purple": ("7030a0", "502070", "a080c0", "604878", "2c1838", "a898b8"),
    "pink": ("f090b0", "e0a8a8", "d06090", "e8c0cc", "a07080"),
    "brown": ("704020", "50301c", "8c5c34", "a0744c", "382414", "70583c"),
    "beige": ("d8c8a8", "c4ac88", "e0d4bc", "b8a48c"),
}
"""Samples of each name, sRGB; a colour has the name of the nearest one."""
NAMES = tuple(PALETTE)
LIGHTNESS_WEIGHT = 0.55
"""Of Lab's L beside a and b: light changes it most."""
BRIGHT, BRIGHT_SHARE, MAX_GAIN = 235, 0.95, 1.6
"""Pictures are brightened until this share of their pixels is below BRIGHT, by MAX_GAIN at most."""
_STEP = 8
"""Colours are told apart in steps of so many of the 256 values of a channel."""
_SCALES = tuple((256 // _STEP) ** power for power in (2, 1, 0))


def seen_colors(
    images: UInt8[np.ndarray, "frame height width 3"],
    instances: Int[np.ndarray, "frame height width"],
) -> dict[int, str]:
    """For each instance id above 0 that is seen, the name that most of its pixels have."""
    votes = color_votes(images, instances)
    return {number: NAMES[int(each.argmax())] for number, each in votes.items()}


def color_votes(
    images: UInt8[np.ndarray, "frame height width 3"],
    instances: Int[np.ndarray, "frame height width"],
) -> dict[int, Int[np.ndarray, " name"]]:
    """For each instance id above 0 that is seen, how many of its pixels have each of NAMES.

    All pictures are brightened alike, as eyes do: a white wall in a dim room is white, not grey.
    The colour of the light stays.
    """
    if not instances.size:
        return {}
    brightened = np.arange(256) * _gain(images)
    steps = (brightened.clip(0, 255) // _STEP).astype(np.int32)
    places = sum(steps[images[..., channel]] * _SCALES[channel] for channel in range(3))
    ids = instances.clip(0).astype(np.int64)
    votes = np.bincount(
        (ids * len(NAMES) + _names_of_colors()[places]).reshape(-1),
        minlength=(int(ids.max()) + 1) * len(NAMES),
    ).reshape(-1, len(NAMES))
    seen = np.flatnonzero(votes.any(axis=1))
    return {int(number): votes[number] for number in seen if number > 0}


def lab(colors: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3"]:
    """CIE L*a*b* (D65) of sRGB colours in [0, 1]."""
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    xyz_from_rgb = np.array([
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ])  # fmt: skip
    xyz = linear @ xyz_from_rgb.T / xyz_from_rgb.sum(axis=1)
    x, y, z = np.moveaxis(
        np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116), -1, 0
    )
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def _gain(images: np.ndarray) -> float:
    counts = np.bincount(images.max(axis=-1).reshape(-1), minlength=256)
    bright = int(np.searchsorted(counts.cumsum(), BRIGHT_SHARE * counts.sum()))
    return min(max(BRIGHT / max(bright, 1), 1.0), MAX_GAIN)


@lru_cache(maxsize=1)
def _names_of_colors() -> np.ndarray:
    """The place in NAMES of each colour, by its steps in red, green and blue."""
    owners = [name for name, samples in enumerate(PALETTE.values()) for _ in samples]
    samples = [list(bytes.fromhex(each)) for group in PALETTE.values() for each in group]
    weights = np.array([LIGHTNESS_WEIGHT, 1, 1])
    middles = (np.arange(256 // _STEP) * _STEP + _STEP / 2) / 255
    grid = np.stack(np.meshgrid(middles, middles, middles, indexing="ij"), axis=-1)
    wanted, known = lab(grid) * weights, lab(np.array(samples) / 255) * weights
    distances = np.stack([((wanted - each) ** 2).sum(axis=-1) for each in known])
    return np.array(owners)[distances.argmin(axis=0)].reshape(-1)
