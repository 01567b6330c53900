import math

import pytest
import torch

from instok3d.evaluation.confusion import Confusion

CLASSES = ("wall", "chair", "bed")


def test_values_worked_by_hand():
    """Two pictures; of the bed, nowhere true, 1 pixel is predicted."""
    confusion = Confusion(CLASSES)
    confusion.add(torch.tensor([[0, 0, 0, 1]]), torch.tensor([[0, 0, 1, 1]]))
    confusion.add(torch.tensor([[1, 1, 0, -1]]), torch.tensor([[1, 2, 0, 0]]))
    assert confusion.counts.tolist() == [[3, 1, 0], [0, 2, 1], [0, 0, 0]]
    ious = confusion.ious()
    assert ious["wall"] == pytest.approx(3 / 4)
    assert ious["chair"] == pytest.approx(2 / 4)
    assert math.isnan(ious["bed"])
    assert confusion.mean_iou() == pytest.approx((3 / 4 + 2 / 4) / 2)
    assert confusion.accuracy() == pytest.approx(5 / 7)
    # First picture: wall 2/3, chair 1/2; second one: wall 1, chair 1/2.
    images = ((2 / 3 + 1 / 2) / 2 + (1 + 1 / 2) / 2) / 2
    assert confusion.mean_iou_of_images() == pytest.approx(images)


def test_perfect_and_always_wrong_predictions():
    truth = torch.tensor([[0, 1], [2, -1]])
    right, wrong = Confusion(CLASSES), Confusion(CLASSES)
    right.add(truth, truth.clamp_min(0))
    wrong.add(truth, (truth.clamp_min(0) + 1) % 3)
    assert (right.mean_iou(), right.accuracy(), right.mean_iou_of_images()) == (1, 1, 1)
    assert (wrong.mean_iou(), wrong.accuracy(), wrong.mean_iou_of_images()) == (0, 0, 0)


def test_counts_in_coarser_classes_are_those_of_coarser_maps():
    torch.manual_seed(0)
    truth, predicted = torch.randint(0, 3, (2, 8, 8))
    places = torch.tensor([0, 1, 1])
    fine, coarse = Confusion(CLASSES), Confusion(("wall", "furniture"))
    fine.add(truth, predicted)
    coarse.add(places[truth], places[predicted])
    assert fine.merged(("wall", "furniture"), places.tolist()).equal(coarse.counts)


def test_without_a_labelled_pixel_there_are_no_figures():
    confusion = Confusion(CLASSES)
    confusion.add(torch.full((2, 2), -1), torch.zeros(2, 2, dtype=torch.int64))
    confusion.add(torch.zeros(0, 4, dtype=torch.int64), torch.zeros(0, 4, dtype=torch.int64))
    assert all(math.isnan(value) for value in confusion.ious().values())
    assert math.isnan(confusion.mean_iou())
    assert math.isnan(confusion.mean_iou_of_images())
    assert math.isnan(confusion.accuracy())


@pytest.mark.parametrize("value", [3, -2])
def test_places_that_are_no_class_are_refused(value: int):
    wrong = torch.tensor([[value]])
    with pytest.raises(ValueError, match="predicted has"):
        Confusion(CLASSES).add(torch.tensor([[0]]), wrong)
    with pytest.raises(ValueError, match="truth has"):
        Confusion(CLASSES).add(wrong, torch.tensor([[0]]))
