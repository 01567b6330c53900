from pathlib import Path

import pytest

from fake_rooms import FakeRooms
from instok3d.datasets.opening import open_training_scenes
from instok3d.datasets.prepared import PreparedScenes
from instok3d.files import write_json
from instok3d.rooms.shards import new_index
from prepared_scenes import made_folder


def test_validation_and_test_rooms_are_never_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    write_json(tmp_path / "rooms.json", new_index(32, "mix"))
    asked = []

    def rooms(folder: Path, seeds: range) -> FakeRooms:
        asked.append(seeds)
        return FakeRooms(1)

    monkeypatch.setattr("instok3d.datasets.opening.RoomDataset", rooms)
    open_training_scenes([tmp_path])
    assert asked == [range(1_000_000)]


def test_prepared_scenes_are_those_of_the_training_split(tmp_path: Path):
    found = open_training_scenes([made_folder(tmp_path, {"a": "train", "b": "test"})])
    assert isinstance(found, PreparedScenes)
    assert [found.name_of(number) for number in range(len(found))] == ["a"]


def test_a_folder_that_is_no_data_set_is_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"neither rooms \(rooms\.json\) nor prepared"):
        open_training_scenes([tmp_path])
    write_json(tmp_path / "rooms.json", new_index(32, "mix"))
    with pytest.raises(ValueError, match="leave masks sam2 out"):
        open_training_scenes([tmp_path], masks="sam2")


def test_folders_are_joined_in_turn_so_that_the_first_scenes_are_of_all(tmp_path: Path):
    folders = [tmp_path / name for name in "mn"]
    for folder in folders:
        folder.mkdir()
    made_folder(folders[0], {"a": "train", "b": "train", "c": "train"})
    made_folder(folders[1], {"p": "train", "q": "test"})
    joined = open_training_scenes(folders)
    names = [joined.name_of(number) for number in range(len(joined))]
    assert names == ["a", "p", "b", "c"]
    alone = open_training_scenes(folders[:1])
    assert joined.num_frames(2) == alone.num_frames(1)
    assert joined.frames(2, [1, 0]).images.equal(alone.frames(1, [1, 0]).images)


def test_scenes_of_one_name_are_refused(tmp_path: Path):
    made_folder(tmp_path, {"a": "train"})
    with pytest.raises(ValueError, match="two of the data sets have a scene 'a'"):
        open_training_scenes([tmp_path, tmp_path])
    with pytest.raises(ValueError, match="no data set to join"):
        open_training_scenes([])
