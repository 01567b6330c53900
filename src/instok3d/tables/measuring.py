"""Measuring cells, scene by scene: what was measured before is taken from its file."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from instok3d.baselines.context_masks import MasksOf, context_masks
from instok3d.baselines.registry import METHODS
from instok3d.baselines.segmenter_file import load_segmenter
from instok3d.baselines.settings import SplatSettings
from instok3d.data.batches import Unit
from instok3d.data.sample import Sample
from instok3d.evaluation.figures import summarize
from instok3d.evaluation.instance_ap import ApSettings
from instok3d.evaluation.methods import Method
from instok3d.evaluation.prediction import Prediction
from instok3d.evaluation.run import EvaluationSettings, score_scene
from instok3d.evaluation.score_files import score_from_json, score_to_json
from instok3d.evaluation.scores import SceneScore
from instok3d.evaluation.sheet import recolored
from instok3d.evaluation.tokenizer_method import GeometryMode, TokenizerMethod
from instok3d.files import write_json
from instok3d.model.files import load_model, read_unit
from instok3d.pictures import color_picture, id_picture
from instok3d.progress import progress_bar
from instok3d.reading import naming_damage, read_json
from instok3d.tables.cells import Asked, Cell, cell_path, read_cell, write_cell
from instok3d.tables.code_version import code_hash
from instok3d.tables.data_sets import digest
from instok3d.tables.definitions import OnePass, PerScene, Tokenizer
from instok3d.tables.features import feature_method, measure_lifted, measure_own
from instok3d.tables.kept_masks import kept_masks
from instok3d.tables.machine import machine_name
from instok3d.tables.picture_files import write_picture
from instok3d.tables.trained import TrainedModel, trained_model
from instok3d.tables.trainings import OURS, SEGMENTER
from instok3d.tables.work import PICTURED, Work, key_of
from instok3d.version import current_commit

MASKS = "masks"
"""Folder of the id maps of context views."""
QUICK_SPLATS = SplatSettings(steps=3, points=200)


def measure(work: Work, asked: Asked, title: str) -> Cell:
    """The cell, measured if it was not before; scenes that were measured are not again.

    Raises:
        ValueError: A scene cannot be measured: nothing is left out.
    """
    path = cell_path(work, asked)
    if path.is_file():
        return read_cell(path)
    if asked.of == "features":
        by_method = measure_lifted if asked.method is None else measure_own
        figures, seconds = by_method(work, asked, path.with_suffix(""), title)
    else:
        figures, seconds = _views(work, asked, path.with_suffix(""), title)
    names = work.scenes(asked.row.scenes, asked.views).names
    models = [trained_model(work, name) for name in asked.trainings]
    method = asked.method
    write_cell(
        path,
        Cell(
            figures=figures,
            method=f"{asked.of} of {method or 'ours, of all kinds'}",
            scenes=len(names),
            scenes_sha256=digest(names),
            weights_sha256=[model.sha256 for model in models],
            command=work.command,
            commit=current_commit(),
            machine=machine_name(),
            seed=_splats(work).seed if isinstance(method, PerScene) else models[-1].seed,
            hours=round(seconds / 3600, 5),
            training_hours=hours_of(models),
        ),
    )
    return read_cell(path)


def hours_of(models: Sequence[TrainedModel]) -> float | None:
    """Of all trainings behind some models; None where nobody knows, or there is none.

    What two of them begin with is counted once.
    """
    runs = {run: hours for model in models for run, hours in model.runs.items()}
    if not runs or None in runs.values():
        return None
    return sum(hours for hours in runs.values() if hours is not None)


def _splats(work: Work) -> SplatSettings:
    if work.schedule.quick:
        return QUICK_SPLATS
    return SplatSettings() if work.method_steps is None else SplatSettings(steps=work.method_steps)


def _views(
    work: Work, asked: Asked, folder: Path, title: str
) -> tuple[Mapping[str, float | None], float]:
    """Figures of pictures and masks, and the seconds that they took."""
    scenes = work.scenes(asked.row.scenes, asked.views)
    folder.mkdir(parents=True, exist_ok=True)
    measured: Callable[[int], SceneScore] | None = None
    scores: list[SceneScore] = []
    seconds = 0.0
    with progress_bar(len(scenes.names), unit="scene") as bar:
        bar.set_description(title)
        for number in range(len(scenes.names)):
            part = folder / part_name(number)
            if not part.is_file():
                measured = measured or _measurer(work, asked, folder)
                started = time.monotonic()
                score = score_to_json(measured(number))
                write_json(part, {"score": score, "seconds": time.monotonic() - started})
            score, took = read_score(part)
            scores.append(score)
            seconds += took
            bar.update()
    figures = {
        name: None if value is None else float(value)
        for name, value in vars(summarize(scores)).items()
        if name != "counts"
    }
    return figures, seconds


def read_score(part: Path) -> tuple[SceneScore, float]:
    """What was measured of one scene, and the seconds that it took.

    Raises:
        FileNotFoundError: It was not measured yet.
        ValueError: The file is damaged.
    """
    remedy = "remove it, the scene is then measured again"
    with naming_damage(part, remedy):
        value = read_json(part, remedy)
        return score_from_json(value["score"]), value["seconds"]


def read_scores(folder: Path, count: int) -> list[SceneScore]:
    """Of the first so many scenes in the folder of a cell; see `read_score`."""
    return [read_score(folder / part_name(number))[0] for number in range(count)]


def part_name(number: int) -> str:
    """Of the file of a scene in the folder of a cell."""
    return f"{number:05d}.json"


def _measurer(work: Work, asked: Asked, folder: Path) -> Callable[[int], SceneScore]:
    """What measures one scene, with the models that it takes loaded once."""
    method, masks_of, unit = _method(work, asked)
    # As `evaluate` has it: instances of a few pixels are not demanded of rooms and captures.
    smallest = 20 if work.schedule.of == "rooms" else 0
    settings = EvaluationSettings(
        geometry=_geometry(method),
        model_unit=unit,
        ap=ApSettings(min_instance_area=smallest),
    )

    @torch.no_grad()
    def measured(number: int) -> SceneScore:
        scene = work.scene(asked.row.scenes, asked.views, number, unit)
        score, predictions = score_scene(
            method, scene, settings, lpips=work.lpips, masks_of=masks_of
        )
        if number < PICTURED and asked.row.scenes == "test":
            _keep_pictures(folder, number, scene.samples, predictions)
        return score

    return measured


def _geometry(method: Method) -> GeometryMode:
    """What a method is told of the context views."""
    if "cameras" in method.needs:
        return "given"
    return "intrinsics" if "intrinsics" in method.needs else "predicted"


def _method(work: Work, asked: Asked) -> tuple[Method, MasksOf | None, Unit | None]:
    row = asked.method
    paths = {name: trained_model(work, name).path for name in asked.trainings}
    if isinstance(row, OnePass):
        return feature_method(work, paths[row.training], row.geometry), None, None
    if isinstance(row, Tokenizer):
        path = paths[row.training]
        steps = min(row.refine, QUICK_SPLATS.steps) if work.schedule.quick else row.refine
        model = load_model(path)
        model.config = replace(model.config, **dict(row.changed))
        return TokenizerMethod(model, row.geometry, steps), None, read_unit(path)
    assert isinstance(row, PerScene)
    settings = _splats(work)
    masks_of = None
    if row.masks is not None and row.tracker is not None:
        masks_of = context_masks(
            row.masks, row.tracker,
            geometry_of=load_model(paths[OURS]).backbone if OURS in paths else None,
            segment=load_segmenter(paths[SEGMENTER]).masks if SEGMENTER in paths else None,
            seed=settings.seed,
        )  # fmt: skip
        if row.masks != "true":
            masks_of = kept_masks(masks_of, _masks_folder(work, asked, settings.seed))
    return METHODS[row.method](settings), masks_of, None


def _masks_folder(work: Work, asked: Asked, seed: int) -> Path:
    """For the masks of a method, which others that are given the same share."""
    row = asked.method
    assert isinstance(row, PerScene)
    key = key_of(
        masks=row.masks, tracker=row.tracker, seed=seed, code=code_hash("measuring"),
        weights=[trained_model(work, name).sha256 for name in asked.trainings],
    )  # fmt: skip
    return work.folder / MASKS / key


def _keep_pictures(
    folder: Path, number: int, samples: Sequence[Sample], predictions: Sequence[Prediction]
) -> None:
    """The first target of a scene as it is and as it was predicted, for the figures."""
    sample, prediction = samples[0], predictions[0]
    true_ids = sample.target_instances[0, 0].cpu().numpy()
    cells = {
        "photo": color_picture(sample.target.images[0, 0]),
        "truth": id_picture(true_ids),
        "render": color_picture(prediction.images[0]),
    }
    if prediction.masks is not None:
        cells["masks"] = id_picture(recolored(prediction.masks[0].ids, true_ids))
    for name, cell in cells.items():
        write_picture(folder / f"{number:05d}_{name}.png", cell)
