"""Which way is up in a scene's world, and how sure that is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

Direction = tuple[float, float, float]

ROLL_RAD = math.radians(3.0)
"""Standard deviation of the roll of hand-held cameras (of our rendered rooms': 1.2 degrees)."""
PITCH_RAD = math.radians(30.0)
"""The same of their pitch: rooms are often taken from eye level, downwards (rendered rooms: 22
degrees down on average)."""
NEAR_RAD = math.radians(15.0)
"""An up axis within this of the true one serves to set a scene upright in a viewer."""
SNAP_RAD = math.radians(20.0)
"""Beyond this up is never taken for an axis; of random directions 18 % lie as near to one."""
UPRIGHT = 0.3
"""Mean cosine between up and the images' up below which the sign of up is in doubt, as of cameras
that look straight down."""
SOURCES = ("first camera", "given cameras", "file", "given")
AXES = "xyz"
STATED = 0.5
"""A direction is stated where it is more likely than not to be within NEAR_RAD of the true one."""


@dataclass(frozen=True)
class Vertical:
    """The up direction of a scene's world."""

    up: Direction
    """Unit length."""
    source: Literal["first camera", "given cameras", "file", "given"]
    """first camera: its image-up direction, which is the world's -y, whatever was photographed.
    given cameras: estimated from how they are turned. file: as an imported file says, or guessed
    with confidence 0 where it says nothing. given: a person said so."""
    confidence: float
    """Probability that it lies within NEAR_RAD of the true one, if people hold cameras level."""

    @staticmethod
    def from_json(value: Any) -> "Vertical":
        """The vertical of an entry of scene.json.

        Raises:
            KeyError, TypeError, ValueError: It is of another form.
        """
        x, y, z = (float(number) for number in value["up"])
        source, confidence = value["source"], float(value["confidence"])
        known = source in SOURCES
        if not known or not 0.99 < math.hypot(x, y, z) < 1.01 or not 0 <= confidence <= 1:
            raise ValueError(
                f"vertical is {value}; wanted up of length 1, a confidence in [0, 1] and as source "
                f"one of {', '.join(SOURCES)}"
            )
        return Vertical((x, y, z), source, confidence)

    @property
    def is_stated(self) -> bool:
        """Whether it is certain enough to be written for other programs."""
        return self.source == "first camera" or self.confidence >= STATED


def given_up(direction: str | Sequence[str | float]) -> Vertical:
    """The vertical that a person states.

    Args:
        direction: An axis, such as "z" or "-y", or three numbers of any length.

    Raises:
        ValueError: It is neither, or all three numbers are 0.
    """
    words = direction.replace(",", " ").split() if isinstance(direction, str) else list(direction)
    if len(words) == 1 and isinstance(words[0], str):
        sign, axis = (-1.0, words[0][1:]) if words[0][:1] == "-" else (1.0, words[0].lstrip("+"))
        if len(axis) == 1 and axis.lower() in AXES:
            words = [sign * (name == axis.lower()) for name in AXES]
    try:
        x, y, z = (float(word) for word in words)
    except (TypeError, ValueError):
        x = y = z = math.nan
    length = math.hypot(x, y, z)
    if not 0 < length < math.inf:
        shown = direction if isinstance(direction, str) else " ".join(map(str, direction))
        raise ValueError(
            f"up must be an axis such as z or -y, or three numbers, not all 0, got {shown!r}"
        )
    # + 0.0: no negative zeros
    return Vertical((x / length + 0.0, y / length + 0.0, z / length + 0.0), "given", 1.0)


def find_vertical(
    cam_from_world: Float[Tensor, "view 4 4"], source: Literal["first camera", "given cameras"]
) -> Vertical:
    """Up in a world that is the first camera's frame, or that of given cameras.

    People tilt a camera up and down but seldom sideways, so that its x axis is about horizontal:
    up is the direction that is most nearly perpendicular to the x axes of all cameras and, as far
    as that leaves it open, to their z axes. An axis of a given world that lies within the
    estimate's own error is taken to be exactly up: most worlds have one that is. The world of the
    first camera has -y for up whatever it was pointed at; the estimate says how likely that is.
    """
    up, deviation_rad = _estimate(cam_from_world)
    if source == "first camera":
        off_rad = math.acos(max(-1.0, min(1.0, -float(up[1]))))
        return Vertical((0.0, -1.0, 0.0), source, _probability_near(off_rad, deviation_rad))
    axis = torch.zeros_like(up)
    largest = int(up.abs().argmax())
    axis[largest] = up[largest].sign()
    if math.acos(min(1.0, float(axis @ up))) < min(deviation_rad, SNAP_RAD):
        up = axis
    x, y, z = (round(value, 6) + 0.0 for value in up.tolist())  # + 0.0: no negative zeros
    return Vertical((x, y, z), source, _probability_near(0.0, deviation_rad))


def _estimate(cam_from_world: Float[Tensor, "view 4 4"]) -> tuple[Float[Tensor, " 3"], float]:
    """The most likely up direction, and its standard deviation where it is least sure, radians."""
    right, down, forward = cam_from_world[:, :3, :3].detach().cpu().double().unbind(1)
    # 1. Negative log likelihood of a direction u: (u . right)^2 over the variance of roll plus
    #    (u . forward)^2 over that of pitch. The mean, not the sum: neighbouring cameras are tilted
    #    alike, so more of them say no more; only cameras turned another way do.
    cost = right.mT @ right / ROLL_RAD**2 + forward.mT @ forward / PITCH_RAD**2
    values, vectors = torch.linalg.eigh(cost / len(right))
    # 2. The sign is that of most images' up.
    up = vectors[:, 0]
    upright = float((-down @ up).mean())
    up = up if upright >= 0 else -up
    # 3. The curvature of the cost gives the deviation. Cameras that no direction explains (a cost
    #    above 1), as where some are held sideways, or a sign in doubt make it larger.
    deviation_rad = 1 / math.sqrt(max(float(values[1] - values[0]), 1e-6))
    in_doubt = min(1.0, abs(upright) / UPRIGHT)
    return up, deviation_rad * max(1.0, float(values[0])) / max(in_doubt, 1e-3)


def _probability_near(off_rad: float, deviation_rad: float) -> float:
    """Probability that a normal deviate about off_rad lies within NEAR_RAD of 0."""

    def below(limit_rad: float) -> float:
        return 0.5 * (1 + math.erf((limit_rad - off_rad) / (math.sqrt(2) * deviation_rad)))

    return round(below(NEAR_RAD) - below(-NEAR_RAD), 3)
