"""The nearest class of an embedding, or none."""

import math

import pytest
import torch

from instok3d.semantics.labels import UNKNOWN, ClassLabel, class_labels
from instok3d.semantics.query.calibration import Calibration
from instok3d.semantics.query.ranking import Vocabulary


def test_labels_by_hand():
    # Cosines 1, 0 and 0.6, 0.8 at a scale of 10: odds of e^10, and of e^2 for the other one.
    vocabulary = Vocabulary(("chair", "table"), torch.eye(2), torch.zeros(2, dtype=torch.bool))
    vectors = torch.tensor([[1.0, 0.0], [0.6, 0.8]])
    sure, fair = 1 / (1 + math.exp(-10)), 1 / (1 + math.exp(-2))
    found = class_labels(vectors, vocabulary, Calibration(class_scale=10.0, label_threshold=0.5))
    assert [each.name for each in found] == ["chair", "table"]
    assert [each.score for each in found] == pytest.approx([sure, fair], rel=1e-5)
    strict = class_labels(vectors, vocabulary, Calibration(class_scale=10.0, label_threshold=0.9))
    assert strict[1] == ClassLabel(UNKNOWN, found[1].score)
    assert class_labels(torch.zeros(0, 2), vocabulary, Calibration()) == []
