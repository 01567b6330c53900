from pathlib import Path

import numpy as np
import pytest

from fake_rooms import fake_scene
from instok3d.files import write_json
from instok3d.rooms.scene import RenderedScene
from instok3d.rooms.shards import ShardRecord, add_to_index, new_index, shard_name, write_shard

SIZE = 32
CLASSES = {1: "chair", 2: "table", 3: "piano"}


def room(seed: int) -> RenderedScene:
    """A box room; transfer rooms have a piano, a concrete box and an unknown type."""
    scene = fake_scene(seed, SIZE)
    transfer = seed >= 3_000_000
    ids = scene.instances.numpy()
    things = [
        {
            "id": number, "class": name, "generator": name, "stuff": False, "color": "red",
            "material": "concrete" if transfer else "wood", "size_m": [1.0, 1.0, 1.0],
            "parent": 0, "aabb_m": [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]],
            "pixels": (ids == number).sum(axis=(1, 2)).tolist(),
        }
        for number, name in CLASSES.items()
        if transfer or name != "piano"
    ]  # fmt: skip
    kind = "studio flat" if transfer else "office"
    return RenderedScene(
        images=scene.images.numpy(),
        instances=ids.astype(np.uint16),
        depths_mm=(scene.depths_m.numpy() * 1000).astype(np.uint16),
        world_from_cam=scene.world_from_cam.numpy().astype(np.float32),
        intrinsics=scene.intrinsics.numpy().astype(np.float32),
        meta={"seed": seed, "level": "easy", "room_type": kind, "instances": things},
    )


@pytest.fixture(scope="session")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three rooms to train on, two to test on, two transfer rooms, of 32 x 32 pixels."""
    folder = tmp_path_factory.mktemp("rooms")
    write_json(folder / "rooms.json", new_index(SIZE, "mix"))
    for start, count in ((0, 3), (2_000_000, 2), (3_000_000, 2)):
        seeds = list(range(start, start + count))
        write_shard(folder / shard_name(start // 16), [room(seed) for seed in seeds])
        add_to_index(folder, start // 16, ShardRecord(seeds, [], ["easy"] * count))
    return folder
