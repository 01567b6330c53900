"""Segmenters on disk: one safetensors file with the weights, the sizes and the card."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from safetensors import safe_open

from instok3d.baselines.segmenter import Segmenter, SegmenterConfig
from instok3d.errors import MissingWeightsError
from instok3d.files import write_safetensors
from instok3d.model.file_checks import check_finite, check_tensors, config_of_json
from instok3d.reading import naming_damage, one_of, parse_json

FORMAT = "instok3d-segmenter-1"
REMEDY = "export it again: instok3d train export"


def save_segmenter(
    model: Segmenter, path: Path, *, card: Mapping[str, Any], half: bool = True
) -> None:
    """Write a segmenter as one safetensors file, atomically; the folder must be there.

    Args:
        model: Any.
        path: Name of the file.
        card: How and on what it was trained: JSON.
        half: Store float16.

    Raises:
        ValueError: A weight is not finite (in float16, where that is asked for).
    """
    state = {name: w.half() if half else w for name, w in model.state_dict().items()}
    check_finite(state, half=half)
    metadata = {
        "format": FORMAT,
        "config": json.dumps(asdict(model.config), allow_nan=False),
        "card": json.dumps(dict(card), allow_nan=False),
    }
    write_safetensors(path, state, metadata)


def load_segmenter(path: Path) -> Segmenter:
    """The segmenter of a file in float32, in eval mode on the CPU.

    Raises:
        MissingWeightsError: There is no such file.
        ValueError: The file is damaged or holds no segmenter of this version.
    """
    if not path.is_file():
        raise MissingWeightsError(
            f"no segmenter {path}; train one (instok3d train nano-segmenter) and export it"
        )
    with naming_damage(path, REMEDY), safe_open(path, framework="pt") as stream:
        metadata = stream.metadata() or {}
        one_of(metadata.get("format"), (FORMAT,))
        config = config_of_json(SegmenterConfig, parse_json(metadata["config"], "", REMEDY), {})
        slices = {name: stream.get_slice(name) for name in stream.keys()}  # noqa: SIM118
        header = {name: (tuple(s.get_shape()), s.get_dtype()) for name, s in slices.items()}
        check_tensors(lambda: Segmenter(config), header)
        state = {name: stream.get_tensor(name) for name in header}
        check_finite(state)
        model = Segmenter(config)
        model.load_state_dict(state)
    return model.eval()
