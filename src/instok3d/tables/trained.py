"""Trained models, each in a folder named by the hash of what it was made from."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from instok3d.datasets.opening import open_training_scenes
from instok3d.files import sha256_of, write_json, write_safetensors
from instok3d.reading import naming_damage, read_json
from instok3d.tables.code_version import code_hash
from instok3d.tables.digests import digest_of
from instok3d.tables.trainings import (
    JOINT,
    OURS,
    SEGMENTER,
    SEMANTICS,
    TRAININGS,
    config_of,
)
from instok3d.tables.work import Work, key_of
from instok3d.training.cache.features import of_backbone
from instok3d.training.checkpoint import has_checkpoint, read_weights
from instok3d.training.config import to_json
from instok3d.training.export import export_model
from instok3d.training.loop import train

RECORD, MODEL, RUN = "trained.json", "model.safetensors", "run"


@dataclass(frozen=True)
class TrainedModel:
    """A model that a row is measured with."""

    path: Path
    sha256: str
    runs: Mapping[str, float | None]
    """Hours of its training and of those that it begins with, by their folders; None where the
    file does not say."""
    seed: int | None


def file_of(work: Work, name: str) -> Path | None:
    """The user's file that stands for a training; None where it has to be trained."""
    return {OURS: work.model, SEMANTICS: work.semantics, SEGMENTER: work.segmenter}.get(name)


def folder_of(work: Work, name: str) -> Path:
    """Where a training lies; what it begins with must be there.

    The name has the hash of settings, training rooms, first weights and code.
    """
    config = config_of(name, work.schedule)
    key = key_of(
        config=to_json(replace(config, threads=None)),
        rooms=work.training_digest(name),
        first=_first_digest(work, name),
        code=code_hash("training"),
    )
    return work.folder / "trained" / f"{name}-{key}"


def first_weights(work: Work, name: str) -> Path | None:
    """The file with which a training begins; None: with random weights, in quick ones alone."""
    after = TRAININGS[name].after
    if after is not None:
        return trained_model(work, after).path
    return None if work.schedule.quick else _backbone(work)


def _first_digest(work: Work, name: str) -> str | None:
    """SHA-256 of what a training begins with; nothing is written."""
    after = TRAININGS[name].after
    if after is not None:
        return trained_model(work, after).sha256
    return None if work.schedule.quick else work.backbone_digest


def _backbone(work: Work) -> Path:
    """The backbone alone: of a tokenizer's file a run would take the tokenizer too."""
    path = work.folder / "trained" / f"backbone-{work.backbone_digest[:12]}.safetensors"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        inner = of_backbone(read_weights(work.backbone))
        write_safetensors(path, {f"backbone.{name}": value for name, value in inner.items()})
    return path


def trained_model(work: Work, name: str) -> TrainedModel:
    """A model that is there.

    Raises:
        FileNotFoundError: It was not trained yet.
        ValueError: Its record or its weights are damaged.
    """
    if (file := file_of(work, name)) is not None:
        if not file.is_file():
            raise FileNotFoundError(f"there is no file {file} of the model that is to be measured")
        return TrainedModel(file, digest_of(file), {str(file): None}, None)
    name = JOINT if name == OURS else name
    folder = folder_of(work, name)
    remedy = f"remove the folder {folder}, it is then trained again"
    record = read_json(folder / RECORD, remedy)
    with naming_damage(folder / RECORD, remedy):
        found = TrainedModel(folder / MODEL, record["sha256"], record["runs"], record["seed"])
    if digest_of(found.path) != found.sha256:
        raise ValueError(f"{found.path} is damaged (not the weights that were written); {remedy}")
    return found


def is_trained(work: Work, name: str) -> bool:
    """Whether a training is done; not where that with which it begins is not."""
    after = TRAININGS[name].after
    if after and file_of(work, after) is None:
        before = JOINT if after == OURS else after
        if not is_trained(work, before):
            return False
    return (folder_of(work, name) / RECORD).is_file()


def train_model(work: Work, name: str) -> TrainedModel:
    """Train, or go on, or take what is there.

    Raises:
        KeyboardInterrupt: It was interrupted, after a checkpoint was saved.
        ValueError: The rooms or the first weights do not fit.
    """
    if is_trained(work, name):
        return trained_model(work, name)
    folder, config = folder_of(work, name), config_of(name, work.schedule)
    folder.mkdir(parents=True, exist_ok=True)
    source = open_training_scenes(work.training_folders(name), masks=config.masks)
    resume = has_checkpoint(folder / RUN)
    outcome = train(
        config, config.stage.build(), source, folder / RUN, resume=resume,
        init_from=None if resume else first_weights(work, name),
    )  # fmt: skip
    if outcome.reason != "finished":
        raise KeyboardInterrupt
    card = export_model(folder / RUN, folder / MODEL, half=False, notes=f"{name}, for tables")
    after = TRAININGS[name].after
    before = {} if after is None else trained_model(work, after).runs
    record = {
        "training": name,
        "sha256": sha256_of(folder / MODEL),
        "runs": {**before, folder.name: card["hours"]},
        "seed": config.seed,
        "steps": config.steps,
        "scenes": card["scenes"],
        "commit": card["commit"],
    }
    write_json(folder / RECORD, record)  # last: with it the training is done
    return trained_model(work, name)
