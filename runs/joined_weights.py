"""The tokenizer of one model with the backbone of another one, as first weights of a run.

    python runs/joined_weights.py TOKENIZER BACKBONE -o FILE

Both are run folders or .safetensors files.
"""

import argparse
from pathlib import Path

from instok3d.files import write_safetensors
from instok3d.training.cache.features import of_backbone
from instok3d.training.checkpoint import read_weights


def main() -> None:
    """Read both and write the joined file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tokenizer", type=Path)
    parser.add_argument("backbone", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    weights = dict(read_weights(arguments.tokenizer))
    backbone = {
        f"backbone.{k}": v for k, v in of_backbone(read_weights(arguments.backbone)).items()
    }
    before = {name for name in weights if name.startswith("backbone.")}
    if before != backbone.keys():
        raise ValueError(
            f"the backbone in {arguments.backbone} is not of the kind in {arguments.tokenizer}: "
            f"they differ in {sorted(before ^ backbone.keys())[:3]}"
        )
    write_safetensors(arguments.output, {**weights, **backbone})


if __name__ == "__main__":
    main()
