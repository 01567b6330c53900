import pytest

from flat_rooms import FlatRooms
from instok3d.evaluation.protocols import TEST_SEEDS, frame_choices, protocol_rooms, room_indices


def test_two_view_targets_stand_between_their_contexts():
    choices = frame_choices("rooms-2view", 16)
    assert [choice.target for choice in choices] == [(3,), (8,), (12,)]
    assert [choice.context for choice in choices] == [(2, 4), (7, 9), (11, 13)]
    centers = [choice.target[0] for choice in frame_choices("rooms-2view", 16, targets_per_scene=5)]
    assert centers == [2, 5, 8, 10, 13]
    every = frame_choices("rooms-2view", 16, targets_per_scene=14)
    assert [choice.target[0] for choice in every] == list(range(1, 15))


def test_eight_view_frames_interleave():
    (choice,) = frame_choices("rooms-8view", 16)
    assert choice.context == (0, 2, 4, 6, 8, 10, 12, 14)
    assert choice.target == (1, 3, 5, 7, 9, 11, 13)


@pytest.mark.parametrize("count", [0, 15])
def test_too_few_or_many_targets_are_refused(count):
    with pytest.raises(ValueError, match=rf"1\.\.14 .* got {count}"):
        frame_choices("rooms-2view", 16, targets_per_scene=count)


def test_only_test_rooms_are_taken_in_the_order_of_seeds():
    seeds = [5, *reversed(TEST_SEEDS), 2_000_100]
    assert room_indices(seeds) == list(range(100, 0, -1))
    assert room_indices(seeds, num_scenes=2) == [100, 99]


def test_rejected_seeds_are_passed_over():
    seeds = [2_000_000, 2_000_002]
    assert room_indices(seeds, rejected=[2_000_001], num_scenes=2) == [0, 1]
    rejected = set(TEST_SEEDS) - set(seeds)
    assert room_indices(seeds, rejected=rejected) == [0, 1]
    with pytest.raises(ValueError, match="2 usable test rooms, got 3"):
        room_indices(seeds, rejected=rejected, num_scenes=3)


def test_missing_test_rooms_name_the_command_that_makes_them():
    with pytest.raises(FileNotFoundError, match=r"instok3d data rooms .* 2000000:2000100"):
        room_indices([1, 2, 3])
    with pytest.raises(FileNotFoundError, match="no room with seed 2000001"):
        room_indices([2_000_000, 2_000_002], num_scenes=2)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        room_indices([2_000_000], num_scenes=0)


def test_rooms_carry_their_level_and_whole_samples():
    source = FlatRooms([2_000_001], ["hard"])
    (room,) = protocol_rooms(source, [0], "rooms-2view", targets_per_scene=2)
    assert (room.name, room.level, len(room.samples)) == ("2000001", "hard", 2)
    sample = room.samples[0]
    assert sample.context.images.shape == (1, 2, 3, 32, 32)
    assert sample.target.images.shape == (1, 1, 3, 32, 32)
