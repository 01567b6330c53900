"""From a run to one file: what its stage is trained for, with a card."""

import json
from pathlib import Path
from typing import Any

from instok3d.reading import naming_damage, reason_of
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.config import TrainConfig, from_json
from instok3d.training.credits import read_credits
from instok3d.training.run_log import read_metrics
from instok3d.training.stages.answers import AveragedRun
from instok3d.training.stages.stage import StageConfig


def export_model(
    run: Path, output: Path, *, half: bool = True, image_side: int | None = None, notes: str = ""
) -> dict[str, Any]:
    """Write the averaged weights of a run's newest checkpoint with a card; returns the card.

    What is written is the stage's (`StageConfig.export`): of a tokenizer run the whole model; of an
    adapt run the backbone alone, which `--init-from` takes.

    Args:
        run: Folder of a run, finished or not.
        output: The .safetensors file; its folder must exist.
        half: Store float16.
        image_side: Height and width of the pictures it was trained on, to which reconstruction
            brings photos, pixels; None = the shorter side of the data set's.
        notes: Free text for the card: data, licence, limits.

    Raises:
        FileNotFoundError: The run has no checkpoint.
        ValueError: The run is of a stage that has no file of its own, such as geometry, or its
            checkpoint is damaged.
    """
    checkpoint = read_checkpoint(run)
    settings = json.loads(checkpoint["config"])
    with naming_damage(checkpoint["path"], "export it with the version that trained it"):
        config = from_json(TrainConfig, settings)
    validation = [x for x in read_metrics(run / "metrics.jsonl") if x["kind"] == "validation"]
    card = {
        "name": output.stem,
        "image_side": image_side or _image_side(checkpoint, config.stage),
        "unit": config.batches.unit if config.stage.learns_unit() else None,
        "steps": checkpoint["step"],
        "hours": round(checkpoint["elapsed_s"] / 3600, 2),
        "scenes": len(checkpoint["scene_names"]),
        "commit": checkpoint["commit"],
        "validation": validation[-1] if validation else {},
        "config": settings,
        "notes": notes,
    }
    if credits := read_credits(run):
        card["credits"] = credits
    weights = {**checkpoint["model"], **checkpoint["average"]}
    try:
        config.stage.export(AveragedRun(run, weights, card), output, half=half)
    except RuntimeError as error:
        raise ValueError(
            f"the weights in {checkpoint['path']} do not fit the model that its settings ask for "
            f"({reason_of(error)}); export it with the version that trained it"
        ) from error
    return card


def _image_side(checkpoint: dict[str, Any], stage: StageConfig) -> int:
    if checkpoint.get("image_size"):
        return min(checkpoint["image_size"])
    return stage.picture_side()  # older checkpoints do not say, and had no others
