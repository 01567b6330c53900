import pytest

from capture_folders import write_capture
from instok3d.tables.data_sets import digest, training_digest, training_folders
from instok3d.tables.scene_sets import (
    SceneSet,
    captures,
    is_held_out,
    rooms_to_test,
    transfer_rooms,
)

THING = {"generator": "chair", "material": "wood", "pixels": [0, 5]}


def test_seeds_say_what_rooms_are_for(rooms, tmp_path):
    assert training_folders([rooms]) == [rooms]
    test = rooms_to_test([rooms], 2, 1)
    assert isinstance(test, SceneSet)
    assert list(test.names) == ["2000000", "2000001"]
    assert test.scene(1, 2, None).name == "2000001"
    assert [len(test.scene(0, views, None).samples[0].names) for views in (2, 8)] == [1, 1]
    for kind in ("held-out furniture", "held-out materials", "held-out room type"):
        assert list(transfer_rooms([rooms], kind, 1, 1).names) == ["3000000"]


@pytest.mark.parametrize(
    ("meta", "kinds"),
    [
        ({"room_type": "studio flat", "instances": []}, {"held-out room type"}),
        ({"room_type": "office", "instances": [THING]}, set()),
        ({"room_type": "office", "instances": [THING | {"generator": "piano"}]},
         {"held-out furniture"}),
        ({"room_type": "office", "instances": [THING | {"material": "brick"}]},
         {"held-out materials"}),
        ({"room_type": "office", "instances": [THING | {"material": "brick", "pixels": [0]}]},
         set()),
    ],
)  # fmt: skip
def test_a_room_is_told_by_what_its_frames_show(meta, kinds):
    every = ("held-out furniture", "held-out materials", "held-out room type")
    assert {kind for kind in every if is_held_out(meta, kind)} == kinds


def test_what_is_missing_is_named_with_what_makes_it(rooms, tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no rooms"):
        training_folders([tmp_path])
    with pytest.raises(FileNotFoundError, match="no room to train on in"):
        training_folders([])
    with pytest.raises(FileNotFoundError, match="--seeds 2000000:2000100"):
        rooms_to_test([], None, 1)
    with pytest.raises(FileNotFoundError, match="no transfer room with held-out furniture"):
        transfer_rooms([], "held-out furniture", None, 1)
    with pytest.raises(FileNotFoundError, match="no capture"):
        captures(tmp_path, 32, 2, 1)


def test_a_capture_with_a_damaged_photo_is_refused_by_name(tmp_path):
    write_capture(tmp_path / "captures" / "flat", 4)
    assert captures(tmp_path / "captures", 32, 2, 1).names == ["flat"]
    (tmp_path / "captures" / "flat" / "color" / "2.png").write_text("../elsewhere/2.png")
    with pytest.raises(ValueError, match=r"2\.png"):
        captures(tmp_path / "captures", 32, 2, 1)


def test_digests_tell_lists_apart(rooms):
    assert digest(["a", "b"]) != digest(["b", "a"]) != digest(["ab"])
    assert len(digest([])) == 64
    assert training_digest([rooms]) == training_digest([rooms]) != training_digest([rooms, rooms])
