"""Adam without `torch.optim.Adam`: making one imports torch._dynamo, which takes a second."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.optim.adam import adam


class Adam:
    """Adam (betas .9 and .999, no weight decay), with a rate for each tensor.

    Args:
        values: What is optimised, changed in place, with its rate; gradients stand in `grad`.
        eps: Added to the root of the second moment.
    """

    def __init__(self, values: list[tuple[Float[Tensor, "..."], float]], *, eps: float) -> None:
        self._eps = eps
        self._rows = [
            (value, rate, torch.zeros_like(value), torch.zeros_like(value), _zero(value))
            for value, rate in values
        ]

    @torch.no_grad()
    def step(self) -> None:
        """One step along the gradients, which are cleared; a value without one stays."""
        for value, rate, first, second, steps in self._rows:
            if value.grad is None:
                continue
            adam(
                [value], [value.grad], [first], [second], [], [steps], fused=True, amsgrad=False,
                beta1=0.9, beta2=0.999, lr=rate, weight_decay=0.0, eps=self._eps, maximize=False,
            )  # fmt: skip
            value.grad = None


def _zero(value: Tensor) -> Float[Tensor, ""]:
    """The number of steps that were done, where the fused kernel wants it."""
    return torch.zeros((), device=value.device)
