"""From a tokenizer run to the one file that reconstruction loads."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from instok3d.model.files import save_model
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.config import TrainConfig, from_json
from instok3d.training.feature_cache import FeatureCache, with_backbone
from instok3d.training.run_log import read_metrics
from instok3d.training.tokenizer_stage import TokenizerStage, TokenizerStageConfig


def export_model(
    run: Path, output: Path, *, half: bool = True, image_side: int = 128, notes: str = ""
) -> dict[str, Any]:
    """Write the averaged weights of a run's newest checkpoint with a card; returns the card.

    Args:
        run: Folder of a tokenizer run, finished or not.
        output: The .safetensors file; its folder must exist.
        half: Store float16.
        image_side: Height and width of the pictures it was trained on, to which reconstruction
            brings photos, pixels.
        notes: Free text for the card: data, licence, limits.

    Raises:
        FileNotFoundError: The run has no checkpoint.
        ValueError: The run is not of the tokenizer stage.
    """
    checkpoint = read_checkpoint(run)
    config = from_json(TrainConfig, json.loads(checkpoint["config"]))
    if not isinstance(config.stage, TokenizerStageConfig):
        raise ValueError(f"{run} trains {type(config.stage).__name__}; export a tokenizer run")
    weights = {**checkpoint["model"], **checkpoint["average"]}
    if config.stage.cache:
        weights = with_backbone(FeatureCache(config.stage.cache), weights)
    model = TokenizerStage(replace(config.stage, cache=None)).build_model()
    model.load_state_dict(weights)
    validation = [x for x in read_metrics(run / "metrics.jsonl") if x["kind"] == "validation"]
    card = {
        "name": output.stem,
        "image_side": image_side,
        "steps": checkpoint["step"],
        "hours": round(checkpoint["elapsed_s"] / 3600, 2),
        "scenes": len(checkpoint["scene_names"]),
        "commit": checkpoint["commit"],
        "validation": validation[-1] if validation else {},
        "config": json.loads(checkpoint["config"]),
        "notes": notes,
    }
    save_model(model, output, card=card, half=half)
    return card
