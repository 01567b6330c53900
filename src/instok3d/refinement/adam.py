"""Adam without `torch.optim.Adam`: making one imports torch._dynamo, which takes a second."""

import torch
from jaxtyping import Bool, Float, Int
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

    def set_rate(self, place: int, rate: float) -> None:
        """The rate of one of the values from now on, by its place among them."""
        value, _, first, second, steps = self._rows[place]
        self._rows[place] = (value, rate, first, second, steps)

    def replace(
        self,
        place: int,
        value: Float[Tensor, "..."],
        source: Int[Tensor, " row"],
        fresh: Bool[Tensor, " row"],
    ) -> None:
        """Optimise another value in the place of one, whose rows were taken from it.

        Args:
            place: Of the value among all.
            value: From now on.
            source: Which of the present rows each row was.
            fresh: Rows whose moments begin at 0; the others keep theirs.
        """
        _, rate, *moments, steps = self._rows[place]
        first, second = (moment[source] for moment in moments)
        first[fresh], second[fresh] = 0, 0
        self._rows[place] = (value, rate, first, second, steps)


def _zero(value: Tensor) -> Float[Tensor, ""]:
    """The number of steps that were done, where the fused kernel wants it."""
    return torch.zeros((), device=value.device)
