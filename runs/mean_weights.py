"""The weighted mean of two models of equal sizes: what a run gained, with less of what it lost.

    python runs/mean_weights.py START END -o FILE [--share 0.5] [--name NAME] [--notes TEXT]

START is the model that a run began with, END what the run exported. A tokenizer that is trained on
for photos finds more of their objects and loses some of clean rooms; between the two weights lie
models that keep most of both (docs/log.md). The card is that of END, without validation figures.
"""

import argparse
from pathlib import Path

import torch
from torch import Tensor

from instok3d.model.files import load_model, read_card, save_model


def mean_weights(
    start: dict[str, Tensor], end: dict[str, Tensor], share: float
) -> dict[str, Tensor]:
    """Start plus that share of the way to the end; what is no float comes from the end.

    Raises:
        ValueError: They differ in names or shapes.
    """
    first, last = ({name: each.shape for name, each in weights.items()} for weights in (start, end))
    if first != last:
        names = sorted({name for name, _ in first.items() ^ last.items()})
        raise ValueError(f"the models differ in their tensors: {names[:3]}")
    return {
        name: torch.lerp(start[name].float(), weight.float(), share)
        if weight.is_floating_point()
        else weight
        for name, weight in end.items()
    }


def main(arguments: list[str] | None = None) -> None:
    """Read both and write the model between them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("start", type=Path)
    parser.add_argument("end", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--share", type=float, default=0.5, help="of the end, 0 to 1")
    parser.add_argument("--name", help="in the card")
    parser.add_argument("--notes", help="in the card")
    given = parser.parse_args(arguments)
    if not 0 <= given.share <= 1:
        raise ValueError(f"--share must lie in 0..1, got {given.share}")
    model = load_model(given.end)
    weights = mean_weights(load_model(given.start).state_dict(), model.state_dict(), given.share)
    model.load_state_dict(weights)
    card = {key: value for key, value in read_card(given.end).items() if key != "validation"}
    changes = {
        "name": given.name or given.output.stem,
        "notes": given.notes or card.get("notes", ""),
    }
    save_model(model, given.output, card={**card, **changes}, half=True)


if __name__ == "__main__":
    main()
