"""Arguments of edits as people give them: checked, and in one form."""

import math
from collections.abc import Sequence
from numbers import Real

from PIL import ImageColor

from instok3d.geometry.moving import Point
from instok3d.types import MAX_LENGTH

Number = int | float
LARGEST_SCALE = 1e6
"""Of an edit; its inverse is the smallest."""


def point(value: Sequence[Number], name: str) -> Point:
    """Three coordinates.

    Raises:
        ValueError: They are not three finite numbers that a scene can hold.
    """
    numbers = list(value) if not isinstance(value, str) else []
    sound = [isinstance(each, Real) and abs(float(each)) <= MAX_LENGTH for each in numbers]
    if len(numbers) != 3 or not all(sound):
        raise ValueError(f"{name} must be three finite numbers, x y z in scene units, got {value}")
    x, y, z = (float(each) for each in numbers)
    return x, y, z


def degrees(value: Number, name: str) -> float:
    """An angle in radians.

    Raises:
        ValueError: It is no finite number.
    """
    if not isinstance(value, Real) or not math.isfinite(value):
        raise ValueError(f"{name} must be a finite number of degrees, got {value}")
    return math.radians(math.remainder(float(value), 360))


def factor(value: Number, name: str) -> float:
    """A scale.

    Raises:
        ValueError: It is not above 0 or too far from 1.
    """
    if not isinstance(value, Real) or not 1 / LARGEST_SCALE <= float(value) <= LARGEST_SCALE:
        raise ValueError(
            f"{name} must be a number above 0, from {1 / LARGEST_SCALE:g} to {LARGEST_SCALE:g}, "
            f"got {value}"
        )
    return float(value)


def color(value: str | Sequence[Number]) -> tuple[float, float, float]:
    """SRGB in [0, 1] of a name such as "red", of "#rrggbb", or of three numbers.

    Raises:
        ValueError: It is none of these.
    """
    if isinstance(value, str):
        try:
            red, green, blue = ImageColor.getrgb(value)[:3]
        except ValueError as error:
            raise ValueError(
                f"{value!r} is no colour: give a name such as red, or #rrggbb"
            ) from error
        return red / 255, green / 255, blue / 255
    numbers = [float(each) if isinstance(each, Real) else math.nan for each in value]
    if len(numbers) != 3 or not all(0 <= each <= 1 for each in numbers):
        raise ValueError(f"a colour must be three numbers in [0, 1], red green blue, got {value}")
    red, green, blue = numbers
    return red, green, blue
