"""A damaged folder of rooms is read, or refused in one line; so is one of impossible rooms."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")

from instok3d.files import write_json
from instok3d.rooms import RoomDataset
from instok3d.rooms.preview import rooms_sheet
from instok3d.rooms.scene import RenderedScene
from instok3d.rooms.shards import (
    ShardRecord,
    add_to_index,
    new_index,
    read_index,
    shard_name,
    write_shard,
)
from mutations import of_json, of_safetensors, survive
from noise_rooms import noise_scene, put


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_json(tmp_path / "rooms.json", new_index(16, "mix"))
    put(tmp_path, 0, [noise_scene(4), noise_scene(9)])
    return tmp_path


def read_all(folder: Path) -> None:
    dataset = RoomDataset(folder)
    for number in range(len(dataset)):
        dataset.frames(number, [0])
        dataset.scene(number)


def test_an_index(folder: Path):
    assert survive(folder / "rooms.json", lambda: read_index(folder), of_json, 200)


def test_a_shard(folder: Path):
    assert survive(folder / shard_name(0), lambda: read_all(folder), of_safetensors, 100)


def changed(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        index = json.loads((folder / "rooms.json").read_text())
        change(index)
        (folder / "rooms.json").write_text(json.dumps(index))

    return apply


def record(index: dict) -> dict:
    return index["shards"][shard_name(0)]


INDEX_DAMAGE = {
    "'16' is no whole number": changed(lambda i: i.update(resolution="16")),
    "no whole number from 1 to 10000": changed(lambda i: i.update(frames=10**9)),
    "is no name of a shard": changed(lambda i: i["shards"].update({"../x": record(i)})),
    "seeds that stand twice": changed(lambda i: record(i)["seeds"].append(4)),
    "not one level for each seed": changed(lambda i: record(i)["levels"].pop()),
    "'x' is none of": changed(lambda i: record(i)["levels"].__setitem__(0, "x")),
    "a value in it is of another kind": changed(lambda i: i.update(shards=[])),
}


@pytest.mark.parametrize("reason", INDEX_DAMAGE)
def test_an_index_that_cannot_be_is_refused_with_the_reason(folder: Path, reason: str):
    INDEX_DAMAGE[reason](folder)
    with pytest.raises(ValueError, match=rf"rooms\.json is damaged \(.*{reason}"):
        read_index(folder)


def changed_scene(name: str, place: tuple[int, ...], value: float) -> RenderedScene:
    scene = noise_scene(4)
    array = getattr(scene, name).copy()
    array[place] = value
    return replace(scene, **{name: array})


SHARD_DAMAGE = {
    "frame 5 of seed 4 has a pose that is not finite": ("world_from_cam", (5, 0, 0), np.nan),
    "has a pose whose rotation is not orthonormal": ("world_from_cam", (5, 0, 0), 3),
    "stands 1e.30 units from": ("world_from_cam", (5, 0, 3), 1e30),
    "has the focal length -1": ("intrinsics", (5, 0, 0), -1),
    "below the diagonal": ("intrinsics", (5, 1, 0), 3),
}
OTHER_ROOMS = {
    "has not the seeds that the index says": noise_scene(5),
    r"images is U8 \[1, 16, 8, 8, 3\], wanted U8 \(1, 16, 16, 16, 3\)": noise_scene(4, 8),
    "intrinsics is F64": replace(noise_scene(4), intrinsics=np.ones((16, 3, 3))),
    "'x' is none of": replace(noise_scene(4), meta=noise_scene(4).meta | {"level": "x"}),
} | {reason: changed_scene(*change) for reason, change in SHARD_DAMAGE.items()}


@pytest.mark.parametrize("reason", OTHER_ROOMS)
def test_rooms_that_cannot_be_are_refused_with_the_reason(tmp_path: Path, reason: str):
    write_json(tmp_path / "rooms.json", new_index(16, "mix"))
    write_shard(tmp_path / shard_name(0), [OTHER_ROOMS[reason]])
    add_to_index(tmp_path, 0, ShardRecord([4], [], ["easy"]))
    with pytest.raises(ValueError, match=rf"rooms-0000000\.safetensors.*{reason}"):
        RoomDataset(tmp_path).frames(0, [0])


def test_a_room_of_which_too_little_is_known_has_no_preview(tmp_path: Path):
    write_json(tmp_path / "rooms.json", new_index(16, "mix"))
    put(tmp_path, 0, [replace(noise_scene(4), meta={"seed": 4, "level": "easy"})])
    with pytest.raises(ValueError, match=r"known of the room of seed 4 is damaged .it lacks 'inst"):
        rooms_sheet(RoomDataset(tmp_path))
