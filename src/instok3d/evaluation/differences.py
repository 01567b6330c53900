"""Whether one method is ahead of another on the same scenes by more than chance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from instok3d.evaluation.instance_ap import average_precision_of, ranked_masks
from instok3d.evaluation.scores import SceneScore

RESAMPLES = 100
PICTURES = ("psnr", "ssim", "lpips")
"""Figures that are means over target views."""
MASKS = ("ap", "ap50", "ap25")
"""Figures of one ranking of the masks of all target views."""


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
        keys: Names in `Figures`, of PICTURES and MASKS. Those that one of the two has not are left
            out.

    Returns:
        By key; nothing for fewer than two scenes.

    Raises:
        ValueError: The scenes are not the same, or a key is another one.
    """
    if unknown := set(keys) - {*PICTURES, *MASKS}:
        raise ValueError(f"no differences of {sorted(unknown)[0]}: of {(*PICTURES, *MASKS)} alone")
    if [each.name for each in scores] != [each.name for each in others]:
        raise ValueError("two methods can only be compared on the same scenes in the same order")
    if len(scores) < 2:
        return {}
    count = len(scores)
    draws = np.random.default_rng(0).integers(count, size=(RESAMPLES, count))
    times = np.stack([np.bincount(draw, minlength=count) for draw in draws])
    times = np.concatenate([np.ones((1, count), dtype=np.int64), times])
    found = {}
    for keys_of, figures in ((PICTURES, _pictures), (MASKS, _masks)):
        asked = [key for key in keys if key in keys_of]
        drawn = figures(scores, times, asked) - figures(others, times, asked)
        for key, values in zip(asked, drawn, strict=True):
            if np.isfinite(values).all():
                found[key] = Difference(float(values[0]), float(values[1:].std(ddof=1)))
    return found


def _pictures(
    scenes: Sequence[SceneScore], times: Int[np.ndarray, "draw scene"], keys: Sequence[str]
) -> Float[np.ndarray, "key draw"]:
    """Means over the target views of the scenes that are drawn; NaN where there is none."""
    found = np.full((len(keys), len(times)), np.nan)
    for place, key in enumerate(keys):
        each = [[getattr(view, key) for view in scene.views] for scene in scenes]
        known = [[value for value in values if value is not None] for values in each]
        count = times @ np.array([len(values) for values in known])
        total = times @ np.array([sum(values) for values in known], dtype=float)
        np.divide(total, count, out=found[place], where=count > 0)
    return found


def _masks(
    scenes: Sequence[SceneScore], times: Int[np.ndarray, "draw scene"], keys: Sequence[str]
) -> Float[np.ndarray, "key draw"]:
    """AP pooled over the target views of the scenes that are drawn; NaN without instances."""
    if not keys:
        return np.zeros((0, len(times)))
    matches = [
        (number, view.matches)
        for number, scene in enumerate(scenes)
        for view in scene.views
        if view.matches
    ]
    scene_of_image = np.array([number for number, _ in matches], dtype=np.int64)
    masks = ranked_masks(image for _, image in matches)  # ranked once: every draw has this order
    drawn = [average_precision_of(masks, each[scene_of_image]) for each in times]
    return np.array([[getattr(each, key) for each in drawn] for key in keys])
