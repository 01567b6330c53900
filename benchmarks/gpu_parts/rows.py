"""What a part is told, and what it says; without torch, so that a start takes no time."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Setting:
    """What every part is told."""

    device: str
    toy: bool

    @property
    def on_gpu(self) -> bool:
        """Whether the device is a CUDA device."""
        return self.device.startswith("cuda")


@dataclass(frozen=True)
class Row:
    """One figure."""

    what: str
    measured: str
    expected: str = ""
    good: bool | None = None
    """None where there is nothing to be right or wrong."""


def at_most(what: str, value: float, bound: float) -> Row:
    """A figure that must not be above a bound; NaN is above every bound."""
    return Row(what, f"{value:.3g}", f"<= {bound:.3g}", value <= bound)


def at_least(what: str, value: float, bound: float) -> Row:
    """A figure that must not be below a bound; NaN is below every bound."""
    return Row(what, f"{value:.3g}", f">= {bound:.3g}", value >= bound)
