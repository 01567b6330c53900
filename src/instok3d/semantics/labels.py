"""The class of each object by its shared embedding, or "unknown"."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from instok3d.semantics.query.calibration import Calibration
from instok3d.semantics.query.ranking import Vocabulary, class_probabilities

UNKNOWN = "unknown"
"""Label of an object whose nearest class is less likely than the calibration's threshold."""


@dataclass(frozen=True)
class ClassLabel:
    """What an embedding names."""

    name: str
    """A class, or UNKNOWN."""
    score: float
    """Probability of the nearest class, [0, 1]."""


def class_labels(
    vectors: Float[Tensor, "object channel"], vocabulary: Vocabulary, calibration: Calibration
) -> list[ClassLabel]:
    """The label of each embedding.

    Args:
        vectors: Of unit length.
        vocabulary: Of their encoder.
        calibration: Likewise.
    """
    scores, nearest = class_probabilities(vectors, vocabulary, calibration.class_scale).max(dim=1)
    return [
        ClassLabel(vocabulary.names[k] if p >= calibration.label_threshold else UNKNOWN, p)
        for p, k in zip(scores.tolist(), nearest.tolist(), strict=True)
    ]
