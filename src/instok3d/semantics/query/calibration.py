"""Similarities to probabilities: one calibration of an encoder for all scenes.

It is fitted on validation rooms (`runs/query_table.py --fit`) and kept with the encoder's weights,
so that no scene needs a threshold of its own.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from instok3d.reading import number

TRUE_SHARE = 0.9
"""Of questions after things that are there: so many are to be answered."""
LARGEST = 1e4
"""Of a number of a calibration; more is taken for damage."""


@dataclass(frozen=True)
class Calibration:
    """How similarities in the space of one encoder are to be read.

    The defaults are those of the teacher of rooms after its first leg, rounded.
    """

    class_scale: float = 28.0
    """Of cosines of objects to class phrases, before the softmax over classes."""
    text_scale: float = 20.0
    """Likewise of cosines of a text to class phrases."""
    color_scale: float = 40.0
    """Likewise of objects to colours and to materials."""
    evidence_weight: float = 1.1
    """Of the logarithm of the probability that object and text are of one class, in the log-odds
    that the object is meant."""
    score_weight: float = 3.5
    """Likewise of the cosine of object and text."""
    bias: float = -0.6
    threshold: float = 0.03
    """Probability below which nothing is said to be there: TRUE_SHARE of the questions after what
    is there pass it."""
    label_threshold: float = 0.47
    """Probability of the nearest class below which an object is "unknown"."""

    def to_json(self) -> dict[str, float]:
        """In plain values."""
        return asdict(self)

    @staticmethod
    def from_json(value: Any) -> "Calibration":
        """The calibration of plain values.

        Raises:
            ValueError: It lacks a number, or holds one that cannot be.
        """
        names = [field.name for field in fields(Calibration)]
        if not isinstance(value, Mapping) or set(value) != set(names):
            raise ValueError(f"a calibration has the numbers {', '.join(names)}, got {value!r}")
        found = {name: number(value[name]) for name in names}
        for name, each in found.items():
            share = name in ("threshold", "label_threshold")
            if not (0 <= each <= 1 if share else abs(each) <= LARGEST):
                raise ValueError(f"the number {name} of a calibration cannot be {each}")
        return Calibration(**found)

    def probability(
        self, scores: Float[Tensor, " object"], evidence: Float[Tensor, " object"]
    ) -> Float[Tensor, " object"]:
        """How likely it is that each object is meant.

        Args:
            scores: Cosine of each with the question.
            evidence: Logarithm of the probability that each is of the class that is asked for.
        """
        odds = self.score_weight * scores + self.evidence_weight * evidence + self.bias
        return odds.sigmoid()


def fit_logistic(
    values: Float[Tensor, "example value"],
    meant: Bool[Tensor, " example"],
    *,
    ridge: float = 1e-3,
    steps: int = 50,
) -> tuple[Float[Tensor, " value"], float]:
    """Weights and bias of the log-odds of `meant`, of most likelihood (Newton's method).

    Args:
        values: What the log-odds are linear in.
        meant: What happened; both kinds, or the ridge alone bounds the weights.
        ridge: Of the weights, in examples.
        steps: Of Newton's method at most.
    """
    design = torch.cat([values.double(), values.new_ones(len(values), 1).double()], dim=1)
    wanted = meant.double()
    weights = torch.zeros(design.shape[1], dtype=torch.float64)
    penalty = ridge * torch.eye(design.shape[1], dtype=torch.float64)
    for _ in range(steps):
        found = (design @ weights).sigmoid()
        slope = design.T @ (found - wanted) + penalty @ weights
        curve = design.T @ (design * (found * (1 - found))[:, None]) + penalty
        step = torch.linalg.solve(curve, slope)
        # Far steps of separable examples overshoot: bounded, they come back.
        weights = weights - step * min(1.0, 5.0 / max(float(step.norm()), 1e-9))
        if float(step.norm()) < 1e-8:
            break
    return weights[:-1].float(), float(weights[-1])


def fit_scale(
    cosines: Float[Tensor, "example choice"], truth: Tensor, *, largest: float = 100.0
) -> float:
    """The scale of cosines whose softmax gives the truth most likelihood, by golden section.

    Args:
        cosines: To each choice.
        truth: Index of the right choice of each example.
        largest: Of the scale; cosines that are always right would have no bound.
    """

    def loss(scale: float) -> float:
        return float(functional.cross_entropy(scale * cosines.double(), truth))

    low, high, golden = 0.0, largest, (math.sqrt(5) - 1) / 2
    for _ in range(40):
        first, second = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, second) if loss(first) < loss(second) else (first, high)
    return (low + high) / 2


def passing_threshold(best: Float[Tensor, " question"], share: float = TRUE_SHARE) -> float:
    """The largest threshold that a share of questions after what is there still pass.

    Args:
        best: Of each question, the probability of its most probable object.
        share: Of the questions.

    Raises:
        ValueError: There is no question.
    """
    if not len(best):
        raise ValueError("no question to choose a threshold by")
    ordered = best.sort(descending=True).values
    return float(ordered[min(len(ordered), math.ceil(share * len(ordered))) - 1])


def naming_threshold(
    scores: Float[Tensor, " object"], right: Bool[Tensor, " object"], share: float = 0.5
) -> float:
    """The least score from which on labels are right in a share of cases at least.

    A label is given where it is more likely right than not. How likely it is rises with the score:
    the isotonic regression of `right` on the scores, so that a few surprises among sure objects do
    not take the labels of all that are less sure.

    Args:
        scores: Of the nearest class of each object.
        right: Whether that is its class.
        share: That are to be right.

    Raises:
        ValueError: There is no object.
    """
    if not len(scores):
        raise ValueError("no object to choose a threshold by")
    # Imported here: it takes a fifth of a second, and reading a scene fits nothing.
    from scipy.optimize import isotonic_regression

    order = scores.argsort(stable=True)
    likely = isotonic_regression(right[order].double().numpy()).x
    good = (likely >= share).nonzero()[0]
    if not len(good):  # even the surest are wrong
        return 1.0
    return float(scores[order[good[0]]]) if good[0] else 0.0
