"""Writing a folder of rooms: whole, resumable, the same bytes; reading it while it grows."""

import dataclasses
import json
import pickle
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import noise_rooms

pytest.importorskip("embreex")

from instok3d.data.words import ObjectWords
from instok3d.files import write_json
from instok3d.pictures import GAP, LINE
from instok3d.rooms import RoomDataset, generate, shards
from instok3d.rooms.generate import GenerationReport, generate_rooms
from instok3d.rooms.preview import rooms_sheet
from instok3d.rooms.scene import RenderedScene, render_scene
from instok3d.rooms.shards import (
    new_index,
    read_index,
    shard_name,
    write_shard,
)
from kill_points import die_in, every_kill
from noise_rooms import noise_scene

make_rooms = partial(generate_rooms, resolution=16, workers=1, progress=False)


def put(folder: Path, shard: int, *seeds: int) -> list[RenderedScene]:
    """A finished shard of noise."""
    scenes = [noise_scene(seed) for seed in seeds]
    noise_rooms.put(folder, shard, scenes)
    return scenes


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_json(tmp_path / "rooms.json", new_index(16, "mix"))
    return tmp_path


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    """One seed to a shard."""
    monkeypatch.setattr(shards, "SHARD_SEEDS", 1)
    monkeypatch.setattr(generate, "SHARD_SEEDS", 1)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_what_was_written_is_read_back_in_order_of_seeds(folder):
    late, early = put(folder, 2, 33, 35), put(folder, 0, 4)
    dataset = RoomDataset(folder)
    assert [dataset.seed_of(i) for i in range(len(dataset))] == [4, 33, 35]
    for number, written in enumerate([*early, *late]):
        scene = dataset.scene(number)
        assert (scene.seed, scene.level) == (written.meta["seed"], "easy")
        np.testing.assert_array_equal(scene.images.numpy(), written.images)
        np.testing.assert_array_equal(scene.instances.numpy(), written.instances)
        np.testing.assert_allclose(scene.depths_m.numpy() * 1000, written.depths_mm, rtol=1e-6)
        np.testing.assert_array_equal(scene.world_from_cam.numpy(), written.world_from_cam)
        np.testing.assert_array_equal(scene.intrinsics.numpy(), written.intrinsics)
        assert scene.meta == written.meta
    with pytest.raises(IndexError):
        dataset.scene(3)


def test_single_frames_are_those_of_the_whole_scene_in_the_order_asked_for(folder):
    put(folder, 0, 4, 9)
    dataset = RoomDataset(folder)
    assert (dataset.name_of(1), dataset.num_frames(1), dataset.level_of(1)) == ("9", 16, "easy")
    some, whole = dataset.frames(1, [7, 2, 7]), dataset.scene(1)
    for name in ("images", "instances", "depths_m", "world_from_cam", "intrinsics"):
        assert getattr(some, name).equal(getattr(whole, name)[[7, 2, 7]])
    with pytest.raises(IndexError, match=r"0\.\.15 exist, got \[16\]"):
        dataset.frames(1, [16])


def test_a_range_of_seeds_can_be_read_alone(folder):
    put(folder, 0, 4, 9)
    dataset = RoomDataset(folder, range(5, 10))
    assert len(dataset) == 1
    assert dataset.scene(0).seed == 9


def test_a_shard_without_usable_scenes_adds_nothing(folder):
    put(folder, 0)
    put(folder, 1, 16)
    assert len(RoomDataset(folder)) == 1


def test_refresh_takes_up_new_shards_and_workers_can_read(folder):
    put(folder, 0, 4)
    dataset = RoomDataset(folder)
    dataset.scene(0)
    put(folder, 1, 17)
    assert len(dataset) == 1
    dataset.refresh()
    assert len(dataset) == 2
    assert pickle.loads(pickle.dumps(dataset)).scene(1).seed == 17


def test_files_that_the_index_does_not_name_are_ignored(folder):
    put(folder, 0, 4)
    whole = (folder / shard_name(0)).read_bytes()
    (folder / shard_name(1)).write_bytes(whole[: len(whole) // 2])  # killed while writing
    (folder / f".{shard_name(1)}.x1y2.safetensors").write_bytes(b"")
    assert len(RoomDataset(folder)) == 1
    assert RoomDataset(folder).scene(0).seed == 4


def test_a_damaged_shard_is_named(folder):
    put(folder, 0, 4)
    path = folder / shard_name(0)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"rooms-0000000.safetensors is damaged"):
        RoomDataset(folder).scene(0)
    path.unlink()
    with pytest.raises(ValueError, match=r"rooms-0000000.safetensors is missing"):
        RoomDataset(folder).scene(0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is damaged"),
        ('{"format": "instok3d-rooms-1", "shar', "is damaged"),
        ('{"format": "instok3d-rooms-1"}', "is damaged: .*shards missing"),
        ('{"format": "others-2", "shards": {}}', "is not an index of rooms"),
        ("[]", "is not an index of rooms"),
    ],
)
def test_a_damaged_index_is_named(tmp_path, text, says):
    (tmp_path / "rooms.json").write_text(text)
    with pytest.raises(ValueError, match=rf"rooms\.json {says}"):
        read_index(tmp_path)


def test_a_folder_without_rooms_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no rooms\.json in .*instok3d data rooms"):
        RoomDataset(tmp_path)


@pytest.mark.usefixtures("small_shards")
def test_an_interrupted_run_goes_on_to_the_same_bytes(tmp_path, monkeypatch):
    straight, stopped = tmp_path / "straight", tmp_path / "stopped"
    assert make_rooms(straight, range(1, 3)) == GenerationReport(2, 0, 0)

    def interrupted(seed: int, *rest):
        if seed == 2:
            raise KeyboardInterrupt
        return render_scene(seed, *rest)

    monkeypatch.setattr(generate, "render_scene", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_rooms(stopped, range(1, 3))
    assert len(RoomDataset(stopped)) == 1
    monkeypatch.setattr(generate, "render_scene", render_scene)
    assert make_rooms(stopped, range(1, 3)) == GenerationReport(1, 0, 1)
    assert contents(stopped) == contents(straight)


def test_the_same_scenes_are_the_same_bytes_every_time(tmp_path):
    # safetensors shuffles its metadata: without care, these would differ.
    scenes = [noise_scene(1)]
    for name in "abcdefgh":
        write_shard(tmp_path / name, scenes)
    assert len(set(contents(tmp_path).values())) == 1
    length = int.from_bytes((tmp_path / "a").read_bytes()[:8], "little")
    assert length % 8 == 0


@pytest.mark.usefixtures("small_shards")
def test_a_deleted_shard_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "render_scene", lambda seed, *rest: noise_scene(seed))
    make_rooms(tmp_path, range(1, 4))
    before = contents(tmp_path)
    (tmp_path / "rooms-0000003.safetensors").unlink()
    assert make_rooms(tmp_path, range(1, 4)) == GenerationReport(1, 0, 2)
    assert contents(tmp_path) == before


@pytest.mark.usefixtures("small_shards")
def test_rejected_seeds_are_counted_and_not_tried_again(tmp_path, monkeypatch, caplog):
    usable = {seed: noise_scene(seed) for seed in (5, 7)}
    monkeypatch.setattr(generate, "render_scene", lambda seed, *rest: usable.get(seed))
    assert make_rooms(tmp_path, range(5, 8)) == GenerationReport(2, 1, 0)
    assert "1 of 3 seeds gave no camera path" in caplog.text
    assert json.loads((tmp_path / "rooms.json").read_text())["shards"][
        "rooms-0000006.safetensors"
    ] == {"seeds": [], "rejected": [6], "levels": []}
    assert make_rooms(tmp_path, range(5, 8)) == GenerationReport(0, 0, 3)
    assert len(RoomDataset(tmp_path)) == 2


def test_two_runs_do_not_write_into_one_folder(tmp_path, monkeypatch):
    def another_run(seed: int, *rest) -> None:
        with pytest.raises(ValueError, match="another run is writing rooms to"):
            make_rooms(tmp_path, range(16, 32))

    monkeypatch.setattr(generate, "render_scene", another_run)
    assert make_rooms(tmp_path, range(16)).rejected == 16
    assert sorted(contents(tmp_path)) == ["rooms-0000000.safetensors", "rooms.json"]


def test_what_a_killed_run_left_is_removed(tmp_path, monkeypatch):
    die_in(tmp_path / shard_name(7))
    monkeypatch.setattr(generate, "render_scene", lambda seed, *rest: None)
    make_rooms(tmp_path, range(16))
    assert sorted(contents(tmp_path)) == ["rooms-0000000.safetensors", "rooms.json"]


@pytest.mark.usefixtures("small_shards")
def test_killed_at_any_operation_it_leaves_whole_rooms_and_is_gone_on_with(tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "render_scene", lambda seed, *rest: noise_scene(seed))
    make_rooms(tmp_path / "straight", range(2))
    whole = contents(tmp_path / "straight")

    def prepare() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        (tmp_path / "work").mkdir()
        return tmp_path / "work"

    def make(work: Path) -> None:
        make_rooms(work / "rooms", range(2))

    seen = set()
    for work in every_kill(prepare, make, step=3):
        folder = work / "rooms"
        dataset = RoomDataset(folder) if (folder / "rooms.json").exists() else []
        seen.add(len(dataset))
        for number in range(len(dataset)):
            room = dataset.scene(number)
            assert np.array_equal(room.images, noise_scene(room.seed).images)
        make(work)
        assert contents(folder) == whole
        assert [path.name for path in work.iterdir()] == ["rooms"]
    assert seen == {0, 1, 2}


def test_whole_shards_are_made_of_what_the_seeds_touch(tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "render_scene", lambda seed, *rest: noise_scene(seed))
    assert make_rooms(tmp_path, range(15, 17)) == GenerationReport(32, 0, 0)
    assert sorted(s for s, *_ in RoomDataset(tmp_path)._scenes) == list(range(32))


def test_a_folder_keeps_to_one_kind_of_rooms(tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "render_scene", lambda seed, *rest: None)
    make_rooms(tmp_path, range(16))
    with pytest.raises(ValueError, match=r"holds rooms with resolution 16, not 32"):
        generate_rooms(tmp_path, range(16), resolution=32, progress=False)
    with pytest.raises(ValueError, match=r"holds rooms with level 'mix', not 'easy'"):
        make_rooms(tmp_path, range(16), level="easy")


def test_another_process_makes_the_same_scene():
    render = partial(render_scene, resolution=16, level="easy")
    with generate._results(render, [1, 4], workers=2) as results:
        others = {scene.meta["seed"]: scene for scene in results}
    for seed in (1, 4):
        here = render(seed)
        for field in dataclasses.fields(RenderedScene):
            mine, theirs = getattr(here, field.name), getattr(others[seed], field.name)
            assert mine == theirs if field.name == "meta" else mine.tobytes() == theirs.tobytes()


def test_contact_sheet_shows_scenes_spread_over_the_folder(folder):
    scenes = put(folder, 0, 1, 2, 3)
    sheet = np.array(rooms_sheet(RoomDataset(folder), scenes=2, views=4))
    cell = 128  # frames of 16 pixels are enlarged eight times
    height = LINE + 3 * (cell + GAP)
    assert sheet.shape == (GAP + 2 * height, GAP + 4 * (cell + GAP), 3)
    for row, scene in ((GAP, scenes[0]), (GAP + height, scenes[2])):  # the first and the last
        top = row + LINE
        assert sheet[row:top].min() < 128  # text
        for column, frame in enumerate((0, 5, 10, 15)):
            left = GAP + column * (cell + GAP)
            tile = sheet[top : top + cell : 8, left : left + cell : 8]
            np.testing.assert_array_equal(tile, scene.images[frame])
        below = top + cell + GAP
        instances = sheet[below : below + cell : 8, GAP : GAP + cell : 8].reshape(-1, 3)
        for value in np.unique(scene.instances[0])[:20]:
            assert len(np.unique(instances[scene.instances[0].ravel() == value], axis=0)) == 1
        depth = sheet[below + cell + GAP : below + 2 * cell + GAP, GAP : GAP + cell]
        assert len(np.unique(depth)) > 1


def test_contact_sheet_of_nothing_is_refused(folder):
    with pytest.raises(ValueError, match="no finished rooms in"):
        rooms_sheet(RoomDataset(folder))
    put(folder, 0, 1)
    with pytest.raises(ValueError, match="1 or more scenes and views, got 0 and 8"):
        rooms_sheet(RoomDataset(folder), scenes=0)


def test_words_have_the_colour_that_is_seen_in_all_frames_together(folder):
    scene = noise_scene(4)
    images, ids = scene.images * 0 + 255, scene.instances * 0 + 3
    images[1:] = (200, 20, 20)
    known = {"id": 3, "class": "sofa", "color": "green", "material": "fabric"}
    hidden = {"id": 9, "class": "bed", "color": "blue", "material": "wood"}
    meta = scene.meta | {"instances": [known, hidden]}
    changed = dataclasses.replace(scene, images=images, instances=ids, meta=meta)
    noise_rooms.put(folder, 0, [changed, noise_scene(9)])
    dataset = RoomDataset(folder)
    words = {3: ObjectWords("sofa", "red", "fabric"), 9: ObjectWords("bed", "blue", "wood")}
    assert dataset.words_of(0) == dataset.frames(0, [0]).words == words
    assert dataset.words_of(1) == {}
