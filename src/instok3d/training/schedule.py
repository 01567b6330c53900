"""What changes with the step: learning rate and loss weights."""

import math


def learning_rate(
    step: int, *, peak: float, warmup_steps: int, cosine_steps: int, final_fraction: float
) -> float:
    """Linear from peak / warmup_steps to peak, then half a cosine down to final_fraction of it.

    The cosine ends at cosine_steps (counted from step 0); later steps stay at the end's value.
    """
    if step < warmup_steps:
        return peak * (step + 1) / warmup_steps
    progress = (step - warmup_steps) / max(1, cosine_steps - warmup_steps)
    cosine = 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))
    return peak * (final_fraction + (1 - final_fraction) * cosine)


def warmed_up(step: int, *, weight: float, warmup_steps: int) -> float:
    """A loss weight that rises linearly from 0 to `weight` over warmup_steps (Sec. 4)."""
    return weight * min(1.0, step / warmup_steps) if warmup_steps else weight
