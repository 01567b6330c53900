"""One picture for a sample: context photos, target, render, true and predicted masks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from instok3d.data.sample import Sample
from instok3d.evaluation.prediction import Prediction
from instok3d.files import replacing
from instok3d.pictures import Section, color_picture, contact_sheet, id_picture


def write_sheet(path: Path, sample: Sample, prediction: Prediction, *, zoom: int = 1) -> None:
    """Write a PNG with a row of context photos and, below, a row for each target view.

    A target's row has the photo, the render, the true ids and the predicted ids, and the render
    from the camera that was fitted to the photo if there is one. A predicted mask
    has the colour of the instance that it covers most of, unless a larger mask has it already;
    black belongs to nothing.

    Args:
        path: Ends in .png; replaced as a whole.
        sample: A batch of one.
        prediction: Of that sample.
        zoom: Each pixel becomes zoom x zoom.
    """
    _write(path, _sections(sample, prediction), zoom * sample.target.images.shape[-2])


def write_scene_sheet(
    path: Path, samples: Sequence[Sample], predictions: Sequence[Prediction], *, most: int = 12
) -> None:
    """Write one PNG for a scene: what `write_sheet` shows of each sample, one below the other.

    Args:
        path: Ends in .png; replaced as a whole.
        samples: Batches of one.
        predictions: Of these samples.
        most: Of more samples so many are shown, spread evenly.
    """
    count = min(most, len(samples))
    shown = [k * len(samples) // count for k in range(count)]
    sections = []
    for number in shown:
        title = samples[number].names[0]
        sections += _sections(samples[number], predictions[number], title=title)
    _write(path, sections, samples[0].target.images.shape[-2])


def _write(path: Path, sections: Sequence[Section], cell_height: int) -> None:
    picture = contact_sheet(sections, cell_height=cell_height)
    with replacing(path) as part:
        picture.save(part, format="PNG")


def _sections(sample: Sample, prediction: Prediction, *, title: str = "context") -> list[Section]:
    sections = [Section(title, list(color_picture(sample.context.images[0])))]
    for target, photo in enumerate(sample.target.images[0]):
        true_ids = sample.target_instances[0, target].cpu().numpy()
        cells = {
            "target": color_picture(photo),
            "render": color_picture(prediction.images[target]),
            "true ids": id_picture(true_ids),
        }
        if prediction.masks is not None:
            predicted = recolored(prediction.masks[target].ids, true_ids)
            cells["predicted ids"] = id_picture(predicted)
        if prediction.aligned is not None:
            cells["aligned render"] = color_picture(prediction.aligned.images[target])
        sections.append(Section("", list(cells.values()), tuple(cells)))
    return sections


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
