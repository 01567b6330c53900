"""`instok3d train`: the training stages, and the export of what they made."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

COMMANDS = {
    "scannet-adapt": "VGGT learns the metres of ScanNet",
    "scannet-2view": "the paper's tokenizer on two views of ScanNet",
    "scannet-8view": "the paper's tokenizer on eight views of ScanNet",
    "scannet-semantics": "features of a 2D encoder in the scenes of that tokenizer",
    "re10k-adapt": "VGGT learns the unit of RealEstate10K",
    "re10k-2view": "the paper's tokenizer on RealEstate10K",
    "nano-geometry": "the nano backbone on rooms",
    "nano-refinement": "its refinement of depth, on top of that",
    "nano-tokenizer": "the tokenizer of the default model",
    "nano-semantics": "features of a 2D encoder in the scenes of the default model",
    "nano-uni3r-style": "a Gaussian with a feature for every pixel, as LSM and Uni3R do it",
    "nano-c3g-style": "2,048 learned Gaussian queries with features, as C3G does it",
    "nano-segmenter": "instances of single photos, for methods that are given masks",
    "nano-adapt": "the nano backbone learns the depths of other scenes",
    "cache": "a frozen backbone's features, written once for a tokenizer run",
    "export": "a run's averaged weights as one file",
}
"""Subcommands of `instok3d train`: the presets of `training.config`, and what goes with them."""


def subcommand(name: str) -> Callable[..., None]:
    """One of COMMANDS. The settings of presets are those of networks, which need PyTorch."""
    if name == "export":
        return export
    if name == "cache":
        from instok3d.cli.train_cache import cache

        return cache
    from instok3d.cli.train_runs import preset_command

    return preset_command(name)


def export(
    run: Annotated[Path, arg(metavar="RUN")],
    /,
    output: Annotated[Path, arg(aliases=["-o"])],
    float32: bool = False,
    notes: str = "",
) -> None:
    """Write a run's averaged weights as one file.

    A tokenizer run gives a model for `reconstruct --model`; an adapt run its backbone, without
    the head, for `--init-from`; a semantics run what lifts its encoder's features into scenes; a
    segmenter run the file for `evaluate --masks segmenter:FILE`.

    Args:
        run: Folder of the run; it may still be going on.
        output: The .safetensors file.
        float32: Full precision, twice the size.
        notes: Text for the model card.
    """
    import torch

    from instok3d.training.export import export_model

    torch.set_num_threads(1)
    card = export_model(run, output, half=not float32, notes=notes)
    print(json.dumps({key: card[key] for key in ("steps", "hours", "scenes", "commit")}))
