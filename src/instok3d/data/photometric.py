"""Random exposure, contrast, white balance and noise: photos of a room never agree in these."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def photometric_change(
    rng: np.random.Generator,
    context: Float[Tensor, "context 3 height width"],
    target: Float[Tensor, "target 3 height width"],
) -> tuple[Float[Tensor, "context 3 height width"], Float[Tensor, "target 3 height width"]]:
    """The images of one scene in other light: one gain, contrast and white balance for all views.

    Targets change with the contexts, or a render could not be predicted from its photos.
    Noise is added to the context alone: nobody wants noise rendered. Results stay in [0, 1].
    """
    gain = float(np.exp(rng.normal(0.0, 0.15)))
    white_balance = torch.from_numpy(np.exp(rng.normal(0.0, 0.05, 3))).float().view(3, 1, 1)
    contrast = float(np.exp(rng.normal(0.0, 0.12)))
    noise_sigma = float(rng.uniform(0.0, 0.02))
    middle = context.mean()

    def change(images: Tensor) -> Tensor:
        return ((images - middle) * contrast + middle) * gain * white_balance

    noise = torch.from_numpy(rng.standard_normal(tuple(context.shape), dtype=np.float32))
    noisy = change(context) + noise_sigma * noise
    return noisy.clamp(0.0, 1.0), change(target).clamp(0.0, 1.0)
