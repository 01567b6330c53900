"""Automatic masks with a segmenter that knows the regions of the picture by their colour."""

import numpy as np
import pytest
import torch

from instok3d.datasets.pseudo_labels.automatic import (
    AutomaticConfig,
    AutomaticMasks,
    PointMasks,
    at_size,
    point_grid,
    stability,
)


class ColourSegmenter:
    """For a point: its region surely, the same unstably, the same with a low predicted IoU."""

    def __init__(self) -> None:
        self.looks = 0
        self.asked: list[int] = []

    def look_at(self, image):
        self.looks += 1
        gray = torch.from_numpy(image[..., 0].astype(np.float32))

        def ask(points):
            self.asked.append(len(points))
            height, width = gray.shape
            x, y = (points[:, 0] * width).long(), (points[:, 1] * height).long()
            region = gray[None] == gray[y, x][:, None, None]
            sure = torch.where(region, 8.0, -8.0)
            faint = torch.where(region, 0.5, -8.0)  # inside at 0, outside at +1
            ious = torch.tensor([0.9, 0.99, 0.5]).repeat(len(points), 1)
            ious[:, 0] += gray[y, x] / 10_000  # brighter regions are surer
            return PointMasks(torch.stack([sure, faint, sure], dim=1), ious)

        return ask


def picture() -> np.ndarray:
    image = np.zeros((20, 30, 3), dtype=np.uint8)
    image[:, 15:] = 100
    image[4:10, 4:10] = 200
    return image


def test_each_region_is_found_once_best_first():
    segmenter = ColourSegmenter()
    config = AutomaticConfig(points_per_side=6, points_at_once=10)
    found = AutomaticMasks(segmenter, config).propose(picture())
    image = picture()[..., 0]
    assert found.masks.shape == (3, 20, 30)
    for mask, colour in zip(found.masks, (200, 100, 0), strict=True):
        np.testing.assert_array_equal(mask, image == colour)
    np.testing.assert_allclose(found.scores, [0.92, 0.91, 0.9], atol=1e-6)
    assert (segmenter.looks, segmenter.asked) == (1, [10, 10, 10, 6])


def test_islands_are_cleaned_away():
    image = picture()
    image[19, 0] = 100  # two pixels of the right half lie in the left
    image[19, 1] = 100
    config = AutomaticConfig(points_per_side=6, min_region_share=3 / 600)
    found = AutomaticMasks(ColourSegmenter(), config).propose(image)
    right = np.zeros((20, 30), dtype=bool)
    right[:, 15:] = True
    np.testing.assert_array_equal(found.masks[1], right)


def test_nothing_good_enough_is_no_mask():
    config = AutomaticConfig(points_per_side=3, min_predicted_iou=0.999)
    found = AutomaticMasks(ColourSegmenter(), config).propose(picture())
    assert found.masks.shape == (0, 20, 30)
    assert found.scores.shape == (0,)


def test_the_grid_lies_at_cell_centres():
    expected = [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]]
    np.testing.assert_allclose(point_grid(2).numpy(), expected)


def test_stability_by_hand():
    logits = torch.tensor([[[2.0, 0.5, -0.5, -2.0]], [[3.0, 3.0, -3.0, -3.0]]])
    # above +1: 1 pixel; above -1: 3 pixels. The second is sharp. An empty mask is not stable.
    np.testing.assert_allclose(stability(logits, 1.0).numpy(), [1 / 3, 1])
    assert stability(torch.full((1, 1, 4), -9.0), 1.0).item() == 0


def test_masks_are_enlarged_about_pixel_centres():
    logits = torch.tensor([[1.0, -1.0]])
    # at 4 pixels the samples lie at 0, 0.25, 0.75, 1 of the way between the two centres
    assert at_size(logits, (1, 4)).tolist() == [[True, True, False, False]]


def test_a_grid_without_points_is_refused():
    with pytest.raises(ValueError, match="points_per_side and points_at_once"):
        AutomaticConfig(points_per_side=0)
