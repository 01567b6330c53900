"""A backbone alone as one file, to start runs from."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor

from instok3d.backbones.base import BackboneConfig
from instok3d.backbones.registry import build_backbone, name_of
from instok3d.files import write_safetensors
from instok3d.model.file_checks import check_finite

FORMAT = "instok3d-backbone-1"


def save_backbone(
    config: BackboneConfig,
    weights: Mapping[str, Tensor],
    output: Path,
    *,
    card: Mapping[str, Any],
    half: bool,
) -> None:
    """Write a backbone's weights with its sizes and a card.

    Args:
        config: Its sizes.
        weights: All of it, by their names in the backbone.
        output: The .safetensors file; its folder must exist.
        card: What the file says of itself, as JSON values.
        half: Store float16.

    Raises:
        ValueError: A weight is not finite (in float16, where that is asked for).
    """
    backbone = build_backbone(config)
    backbone.load_state_dict(dict(weights))
    state = {
        name: value.half() if half and value.is_floating_point() else value
        for name, value in backbone.state_dict().items()
    }
    check_finite(state, half=half)
    metadata = {
        "format": FORMAT,
        "backbone": name_of(backbone),
        "backbone_config": json.dumps(asdict(config)),
        "card": json.dumps(card),
    }
    write_safetensors(output, state, metadata)
