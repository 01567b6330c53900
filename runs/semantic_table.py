"""How well features lifted into the default model's scenes name pixels of the test rooms.

python runs/semantic_table.py ROOMS [--semantics FILE] [--scenes 100] [--targets-per-scene 1]
    [--models FILE ...]

Prints the table of docs/results.md: photos alone, protocol rooms-2view, each row of
`instok3d.evaluation.semantic_lifting` in the context views (source) and in the target view.
--models adds rows of models of other methods, by the encoder of the semantics.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import torch
from tqdm import tqdm

from instok3d.baselines.feature_files import load_feature_model, name_of_model
from instok3d.baselines.feature_method import FeatureMethod
from instok3d.data.sample import Sample
from instok3d.evaluation.method_features import measure_features
from instok3d.evaluation.protocols import protocol_rooms, room_indices
from instok3d.evaluation.semantic_lifting import (
    KINDS,
    LiftedScene,
    lifted_scene,
    measure_lifting,
    table,
)
from instok3d.model.files import load_model
from instok3d.rooms.dataset import RoomDataset
from instok3d.rooms.shards import read_index
from instok3d.scene.lifting import Lifting, find_lifting


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("rooms", type=Path)
    parser.add_argument(
        "--semantics", default="auto", help="a file; else that of the default model"
    )
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--targets-per-scene", type=int, default=1)
    parser.add_argument("--models", type=Path, nargs="+", default=[])
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS)
    given = parser.parse_args()
    tokenizer = load_model()
    lifting = find_lifting(given.semantics, tokenizer, default=True)
    if lifting is None:
        raise ValueError("the default model has no semantics here: give --semantics FILE")
    rooms = RoomDataset(given.rooms)
    seeds = [rooms.seed_of(number) for number in range(len(rooms))]
    shards = read_index(given.rooms)["shards"].values()
    rejected = {seed for shard in shards for seed in shard["rejected"]}
    indices = room_indices(seeds, rejected=rejected, num_scenes=given.scenes)

    def samples() -> Iterator[Sample]:
        asked = protocol_rooms(
            rooms, indices, "rooms-2view", targets_per_scene=given.targets_per_scene
        )
        for room in tqdm(asked, total=len(indices), unit="room"):
            yield from room.samples

    def scenes(lifting: Lifting) -> Iterator[LiftedScene]:
        for sample in samples():
            yield lifted_scene(tokenizer, lifting.model, lifting.encoder.teacher, sample)

    teacher = lifting.encoder.teacher
    figures = dict(measure_lifting(scenes(lifting), teacher, given.kinds)) if given.kinds else {}
    for file in given.models:
        model = load_feature_model(file)
        method = FeatureMethod(model, teacher=teacher)
        name = f"{name_of_model(model)} {file.name}"
        figures[name] = measure_features(method, samples(), teacher)
    print(table(figures))


if __name__ == "__main__":
    with torch.no_grad():
        main()
