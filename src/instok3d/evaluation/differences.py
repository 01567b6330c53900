"""Whether one method is ahead of another on the same scenes by more than chance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from instok3d.evaluation.figures import summarize
from instok3d.evaluation.scores import SceneScore

RESAMPLES = 100


@dataclass(frozen=True)
class Difference:
    """Of a figure of two methods."""

    value: float
    standard_error: float
    """Over the choice of scenes; it knows nothing of other seeds of a training."""


def differences(
    scores: Sequence[SceneScore], others: Sequence[SceneScore], keys: Sequence[str]
) -> Mapping[str, Difference]:
    """Figures of one method minus those of another that was measured on the same scenes.

    The standard error is that of the paired bootstrap: scenes are drawn with replacement, the same
    for both methods, 100 times, seed 0.

    Args:
        scores: Of the one method.
        others: Of the other, the same scenes in the same order.
        keys: Names in `Figures`. Those that one of the two has not are left out.

    Returns:
        By key; nothing for fewer than two scenes.

    Raises:
        ValueError: The scenes are not the same.
    """
    if [each.name for each in scores] != [each.name for each in others]:
        raise ValueError("two methods can only be compared on the same scenes in the same order")
    if len(scores) < 2:
        return {}
    count = len(scores)
    draws = np.random.default_rng(0).integers(count, size=(RESAMPLES, count)).tolist()
    draws.insert(0, list(range(count)))
    drawn = np.array([_figures(scores, d, keys) - _figures(others, d, keys) for d in draws])
    found = {}
    for place, key in enumerate(keys):
        values = drawn[:, place]
        if np.isfinite(values).all():
            found[key] = Difference(float(values[0]), float(values[1:].std(ddof=1)))
    return found


def _figures(scores: Sequence[SceneScore], draw: Sequence[int], keys: Sequence[str]) -> np.ndarray:
    """The figures over some scenes; NaN where there is none."""
    figures = vars(summarize([scores[number] for number in draw]))
    return np.array([figures[key] for key in keys], dtype=float)
