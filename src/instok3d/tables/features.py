"""Features lifted into the scenes of a model, measured for all kinds at once."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import torch

from instok3d.evaluation.semantic_lifting import (
    ANCHOR,
    BOTH,
    ENCODER,
    GAUSSIANS,
    GROUP,
    PIXELS,
    LiftedFigures,
    LiftedScene,
    feature_maps,
    lifted_scene,
    measure_lifting,
)
from instok3d.evaluation.teachers import nearest_class
from instok3d.model.files import load_model
from instok3d.pictures import color_picture, id_picture
from instok3d.progress import progress_bar
from instok3d.scene.lifting import find_lifting
from instok3d.semantics.classes import LSM_OF_ROOM, PHRASES
from instok3d.semantics.teacher import Teacher
from instok3d.semantics.teachers.file import holds_encoder
from instok3d.tables.cells import Asked, semantics_file
from instok3d.tables.picture_files import write_picture
from instok3d.tables.trained import trained_model
from instok3d.tables.trainings import OURS
from instok3d.tables.work import PICTURED, Work

KINDS = (ENCODER, PIXELS, GAUSSIANS, ANCHOR, GROUP, BOTH)
"""What Tables 1 and 4 show."""


def figure_name(kind: str, key: str) -> str:
    """The name in a cell of a figure of one kind of features."""
    return f"{kind}: {key}"


@torch.no_grad()
def measure_features(
    work: Work, asked: Asked, folder: Path, title: str
) -> tuple[Mapping[str, float | None], float]:
    """Figures of all KINDS on the first target of each sample, and the seconds that they took.

    Raises:
        ValueError: The semantics are of another model; or no pixel has a class.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tokenizer = load_model(trained_model(work, OURS).path)
    file = semantics_file(work)
    elsewhere = None if holds_encoder(file) else work.schedule.teacher
    lifting = find_lifting(file, tokenizer, default=False, teacher=elsewhere)
    assert lifting is not None
    teacher = lifting.encoder.teacher
    scenes = work.scenes(asked.row.scenes, asked.views)
    started = time.monotonic()
    with progress_bar(len(scenes.names), unit="scene") as bar:
        bar.set_description(title)

        def lifted() -> Iterator[LiftedScene]:
            for number in range(len(scenes.names)):
                scene = work.scene(asked.row.scenes, asked.views, number, None)
                for place, sample in enumerate(scene.samples):
                    found = lifted_scene(tokenizer, lifting.model, teacher, sample)
                    if place == 0 and number < PICTURED:
                        _keep_pictures(folder, number, found, teacher)
                    yield found
                bar.update()

        measured = measure_lifting(lifted(), teacher, KINDS)
    figures = {
        figure_name(kind, key): value
        for kind, found in measured.items()
        for key, value in _figures(found).items()
    }
    return figures, time.monotonic() - started


def _figures(found: LiftedFigures) -> dict[str, float]:
    return {
        "source_miou": found.source.lsm.mean_iou(),
        "source_accuracy": found.source.lsm.accuracy(),
        "target_miou": found.target.lsm.mean_iou(),
        "target_accuracy": found.target.lsm.accuracy(),
        "stored": sum(found.scalars) / len(found.scalars),
    }


def _keep_pictures(folder: Path, number: int, scene: LiftedScene, teacher: Teacher) -> None:
    """LSM's classes in the target by each kind of features, beside the true ones."""
    phrases, onto = teacher.text(PHRASES), torch.tensor(LSM_OF_ROOM)
    target = scene.num_context
    size = (scene.photos.shape[-2], scene.photos.shape[-1])
    truth = scene.classes[1, target]
    cells = {"photo": color_picture(scene.photos[target]), "truth": id_picture(truth + 1)}
    for place, kind in enumerate(KINDS):
        maps, _ = feature_maps(scene, kind, phrases)
        named = onto[nearest_class(maps[target : target + 1], phrases, size)[0]]
        cells[f"kind{place}"] = id_picture(named + 1)
    for name, cell in cells.items():
        write_picture(folder / f"{number:05d}_{name}.png", cell)
