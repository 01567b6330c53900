"""Features measured: those lifted into the scenes of a model, or those that a method has itself."""

import time
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.baselines.feature_files import load_feature_model
from instok3d.baselines.feature_method import FeatureMethod
from instok3d.data.sample import Sample
from instok3d.evaluation.method_features import SeenFeatures, measure_features
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
from instok3d.evaluation.tokenizer_method import GeometryMode
from instok3d.model.files import load_model
from instok3d.pictures import color_picture, id_picture
from instok3d.progress import progress_bar
from instok3d.scene.lifting import find_lifting
from instok3d.semantics.classes import LSM_OF_ROOM, PHRASES
from instok3d.semantics.teacher import Teacher
from instok3d.semantics.teachers.file import holds_encoder
from instok3d.semantics.teachers.opening import open_teacher
from instok3d.tables.cells import Asked, semantics_file
from instok3d.tables.definitions import OWN, OnePass
from instok3d.tables.picture_files import write_picture
from instok3d.tables.trained import trained_model
from instok3d.tables.trainings import OURS
from instok3d.tables.work import PICTURED, Work

KINDS = (ENCODER, PIXELS, GAUSSIANS, ANCHOR, GROUP, BOTH)
"""Lifted ones that Tables 1 and 4 show."""


def figure_name(kind: str, key: str) -> str:
    """The name in a cell of a figure of one kind of features, of KINDS or OWN."""
    return f"{kind}: {key}"


def picture_name(kind: str) -> str:
    """Of the picture of one kind of features, of KINDS or OWN."""
    return "own" if kind == OWN else f"kind{KINDS.index(kind)}"


@torch.no_grad()
def measure_lifted(
    work: Work, asked: Asked, folder: Path, title: str
) -> tuple[Mapping[str, float | None], float]:
    """Figures of all KINDS in the scenes of OURS, and the seconds that they took.

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
    phrases = teacher.text(PHRASES)
    started = time.monotonic()

    def lifted() -> Iterator[LiftedScene]:
        for sample, number in _samples(work, asked, title):
            found = lifted_scene(tokenizer, lifting.model, teacher, sample)
            if number is not None:
                first = found.num_context
                _keep_truth(folder, number, sample, found.classes[1, first])
                for kind in KINDS:
                    maps, _ = feature_maps(found, kind, phrases)
                    _keep_classes(folder, number, kind, maps[first], phrases, sample)
            yield found

    measured = measure_lifting(lifted(), teacher, KINDS)
    figures = {
        figure_name(kind, key): value
        for kind, found in measured.items()
        for key, value in _figures(found).items()
    }
    return figures, time.monotonic() - started


@torch.no_grad()
def measure_own(
    work: Work, asked: Asked, folder: Path, title: str
) -> tuple[Mapping[str, float | None], float]:
    """Figures of the features that a model of one pass gives its Gaussians, and the seconds.

    Raises:
        ValueError: No pixel has a class.
    """
    folder.mkdir(parents=True, exist_ok=True)
    assert isinstance(asked.method, OnePass)
    teacher = _teacher(work.schedule.teacher)
    method = feature_method(
        work, trained_model(work, asked.method.training).path, asked.method.geometry
    )
    phrases = teacher.text(PHRASES)
    started = time.monotonic()
    shown: dict[str, int] = {}

    def samples() -> Iterator[Sample]:
        for sample, number in _samples(work, asked, title):
            if number is not None:
                shown[sample.names[0]] = number
            yield sample

    def keep(sample: Sample, seen: SeenFeatures) -> None:
        number = shown.pop(sample.names[0], None)
        if number is not None:
            first = seen.truth.num_context
            _keep_truth(folder, number, sample, seen.truth.classes[1, first])
            _keep_classes(folder, number, OWN, seen.maps[first], phrases, sample)

    found = measure_features(method, samples(), teacher, keep)
    figures = {figure_name(OWN, key): value for key, value in _figures(found).items()}
    return figures, time.monotonic() - started


def feature_method(work: Work, path: Path, geometry: GeometryMode) -> FeatureMethod:
    """The model of one pass of a file, with what it sees of the context views."""
    model = load_feature_model(path)
    teacher = _teacher(work.schedule.teacher) if model.takes_features else None
    return FeatureMethod(model, geometry, teacher)


@lru_cache(maxsize=1)
def _teacher(text: str) -> Teacher:
    return open_teacher(text)


def _samples(work: Work, asked: Asked, title: str) -> Iterator[tuple[Sample, int | None]]:
    """Every sample, with the number of its scene where the figures show it, and progress."""
    scenes = work.scenes(asked.row.scenes, asked.views)
    with progress_bar(len(scenes.names), unit="scene") as bar:
        bar.set_description(title)
        for number in range(len(scenes.names)):
            samples = work.scene(asked.row.scenes, asked.views, number, None).samples
            for place, sample in enumerate(samples):
                yield sample, number if place == 0 and number < PICTURED else None
            bar.update()


def _figures(found: LiftedFigures) -> dict[str, float]:
    return {
        "source_miou": found.source.lsm.mean_iou(),
        "source_accuracy": found.source.lsm.accuracy(),
        "target_miou": found.target.lsm.mean_iou(),
        "target_accuracy": found.target.lsm.accuracy(),
        "stored": sum(found.scalars) / len(found.scalars),
    }


def _keep_classes(
    folder: Path,
    number: int,
    kind: str,
    maps: Float[Tensor, "feature row column"],
    phrases: Float[Tensor, "phrase feature"],
    sample: Sample,
) -> None:
    """LSM's classes in the first target of a sample, by features there."""
    height, width = sample.target.images.shape[-2:]
    named = torch.tensor(LSM_OF_ROOM)[nearest_class(maps[None], phrases, (height, width))[0]]
    write_picture(folder / f"{number:05d}_{picture_name(kind)}.png", id_picture(named + 1))


def _keep_truth(
    folder: Path, number: int, sample: Sample, classes: Int[Tensor, "height width"]
) -> None:
    """The first target of a sample and LSM's classes in it."""
    cells = {"photo": color_picture(sample.target.images[0, 0]), "truth": id_picture(classes + 1)}
    for name, cell in cells.items():
        write_picture(folder / f"{number:05d}_{name}.png", cell)
