"""From a run to one file: a model that reconstruction loads, or a backbone to start from."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor

from instok3d.backbones.registry import build_backbone, name_of
from instok3d.backbones.vggt import VGGTConfig
from instok3d.files import write_safetensors
from instok3d.model.files import save_model
from instok3d.training.cache.features import FeatureCache, of_backbone, with_backbone
from instok3d.training.checkpoint import read_checkpoint
from instok3d.training.config import TrainConfig, from_json
from instok3d.training.run_log import read_metrics
from instok3d.training.stages.adapt import AdaptStageConfig
from instok3d.training.stages.geometry import GeometryStageConfig
from instok3d.training.stages.tokenizer import TokenizerStageConfig, new_tokenizer

BACKBONE_FORMAT = "instok3d-backbone-1"


def export_model(
    run: Path, output: Path, *, half: bool = True, image_side: int | None = None, notes: str = ""
) -> dict[str, Any]:
    """Write the averaged weights of a run's newest checkpoint with a card; returns the card.

    Of a tokenizer run the whole model; of an adapt run the backbone alone, whose head has done its
    work: `--init-from` takes it.

    Args:
        run: Folder of a tokenizer run or an adapt run, finished or not.
        output: The .safetensors file; its folder must exist.
        half: Store float16.
        image_side: Height and width of the pictures it was trained on, to which reconstruction
            brings photos, pixels; None = the shorter side of the data set's.
        notes: Free text for the card: data, licence, limits.

    Raises:
        FileNotFoundError: The run has no checkpoint.
        ValueError: The run is of the geometry stage.
    """
    checkpoint = read_checkpoint(run)
    config = from_json(TrainConfig, json.loads(checkpoint["config"]))
    stage = config.stage
    if isinstance(stage, GeometryStageConfig):
        raise ValueError(
            f"{run} trains {type(stage).__name__}, which is given on by its folder; export a "
            "tokenizer run or an adapt run"
        )
    weights = {**checkpoint["model"], **checkpoint["average"]}
    validation = [x for x in read_metrics(run / "metrics.jsonl") if x["kind"] == "validation"]
    card = {
        "name": output.stem,
        "image_side": image_side or _image_side(checkpoint, stage),
        "unit": config.batches.unit if stage.target_cameras == "true" else None,
        "steps": checkpoint["step"],
        "hours": round(checkpoint["elapsed_s"] / 3600, 2),
        "scenes": len(checkpoint["scene_names"]),
        "commit": checkpoint["commit"],
        "validation": validation[-1] if validation else {},
        "config": json.loads(checkpoint["config"]),
        "notes": notes,
    }
    if isinstance(stage, AdaptStageConfig):
        _save_backbone(stage, of_backbone(weights), output, card, half)
        return card
    if stage.cache:
        weights = with_backbone(FeatureCache(stage.cache), weights)
    model = new_tokenizer(stage)
    model.load_state_dict(weights)
    save_model(model, output, card=card, half=half)
    return card


def _image_side(checkpoint: dict[str, Any], stage: AdaptStageConfig | TokenizerStageConfig) -> int:
    if checkpoint.get("image_size"):
        return min(checkpoint["image_size"])
    # Older checkpoints do not say; their runs were on pictures for which the backbone is made.
    return stage.backbone.img_size if isinstance(stage.backbone, VGGTConfig) else 128


def _save_backbone(
    stage: AdaptStageConfig,
    weights: dict[str, Tensor],
    output: Path,
    card: dict[str, Any],
    half: bool,
) -> None:
    backbone = build_backbone(stage.backbone)
    backbone.load_state_dict(weights)
    state = {
        name: value.half() if half and value.is_floating_point() else value
        for name, value in backbone.state_dict().items()
    }
    for name, value in state.items():
        if not value.isfinite().all():
            raise ValueError(f"weight {name} is not finite{' in float16' if half else ''}")
    metadata = {
        "format": BACKBONE_FORMAT,
        "backbone": name_of(backbone),
        "backbone_config": json.dumps(asdict(stage.backbone)),
        "card": json.dumps(card),
    }
    write_safetensors(output, state, metadata)
