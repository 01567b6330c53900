"""One picture for a sample: context photos, target, render, true and predicted masks."""

import colorsys
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.prediction import Prediction
from instok3d.files import replacing

GAP = 4
"""White pixels between the tiles."""


def write_sheet(path: Path, sample: Sample, prediction: Prediction, *, zoom: int = 1) -> None:
    """Write a PNG with a row of context photos and, below, a row for each target view.

    A target's row has the photo, the render, the true ids and the predicted ids. A predicted mask
    has the colour of the instance that it covers most of, unless a larger mask has it already;
    black belongs to nothing.

    Args:
        path: Ends in .png; replaced as a whole.
        sample: A batch of one.
        prediction: Of that sample.
        zoom: Each pixel becomes zoom x zoom.
    """
    rows = [[_picture(photo) for photo in sample.context.images[0]]]
    for target, photo in enumerate(sample.target.images[0]):
        true_ids = sample.target_instances[0, target].cpu().numpy()
        predicted = recolored(prediction.masks[target].ids, true_ids)
        rows.append(
            [
                _picture(photo),
                _picture(prediction.images[target]),
                _colored(np.maximum(true_ids, 0)),
                _colored(predicted),
            ]
        )
    height, width = (side + GAP for side in rows[0][0].shape[:2])
    columns = max(len(row) for row in rows)
    canvas = np.full((len(rows) * height + GAP, columns * width + GAP, 3), 255, np.uint8)
    for y, row in enumerate(rows):
        for x, tile in enumerate(row):
            top, left = GAP + y * height, GAP + x * width
            canvas[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    picture = Image.fromarray(canvas.repeat(zoom, axis=0).repeat(zoom, axis=1))
    with replacing(path) as part:
        picture.save(part, format="PNG")


def recolored(
    predicted_ids: Int[np.ndarray, "height width"], true_ids: Int[np.ndarray, "height width"]
) -> Int[np.ndarray, "height width"]:
    """Predicted masks renamed to the instances they cover most of, larger masks first.

    What covers no instance, or one that is taken, gets a new id; 0 where no mask is.
    """
    result = np.zeros_like(true_ids)
    groups, areas = np.unique(predicted_ids[predicted_ids >= 0], return_counts=True)
    taken: set[int] = set()
    free = int(max(true_ids.max(initial=0), 0)) + 1
    for group in groups[np.argsort(-areas, kind="stable")]:
        mask = predicted_ids == group
        below = true_ids[mask & (true_ids > 0)]
        instance = int(np.bincount(below).argmax()) if len(below) else free
        if instance in taken or instance == free:
            instance, free = free, free + 1
        taken.add(instance)
        result[mask] = instance
    return result


def _picture(image: Float[Tensor, "3 height width"]) -> UInt8[np.ndarray, "height width 3"]:
    pixels = image.detach().cpu().clamp(0, 1).permute(1, 2, 0).numpy()
    return (pixels * 255 + 0.5).astype(np.uint8)


def _colored(ids: Int[np.ndarray, "height width"]) -> UInt8[np.ndarray, "height width 3"]:
    """Colours by id, those of neighbouring ids far apart; 0 is black."""
    palette = [(0.0, 0.0, 0.0)] + [
        colorsys.hsv_to_rgb((0.618034 * k) % 1, 0.5 + 0.4 * (k % 2), 0.95 - 0.25 * (k // 2 % 2))
        for k in range(int(ids.max(initial=0)))
    ]
    return (np.array(palette)[ids] * 255).astype(np.uint8)
