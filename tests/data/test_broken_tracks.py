import numpy as np
import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.broken_tracks import BreakSettings, BrokenTracks, track_ids
from instok3d.data.scenes import SceneSource

ALWAYS = BreakSettings(on_return=1.0, in_sight=0.0, min_pixels=2)
NEVER = BreakSettings(on_return=0.0, in_sight=0.0)
OFTEN = BreakSettings(in_sight=0.6, min_pixels=1)


def shown(*frames: tuple[int, ...]) -> torch.Tensor:
    """Frames of one row of pixels."""
    return torch.tensor(frames)[:, None]


def tracks(instances: torch.Tensor, settings: BreakSettings) -> list[dict[int, int]]:
    return [dict(each) for each in track_ids(instances, np.random.default_rng(0), settings)]


def test_a_thing_that_comes_back_has_a_new_id_and_one_that_stays_has_its_own():
    maps = shown((1, 1, 2, 2), (0, 0, 2, 2), (1, 1, 2, 2), (1, 1, 2, 2))
    assert tracks(maps, ALWAYS) == [{1: 1, 2: 2}, {2: 2}, {1: 3, 2: 2}, {1: 3, 2: 2}]


def test_a_glimpse_below_the_least_area_is_out_of_sight():
    # In frame 1 one pixel of id 1 is left: still its old track, but the tracker has lost it.
    assert tracks(shown((1, 1), (1, 0), (1, 1)), ALWAYS) == [{1: 1}, {1: 1}, {1: 2}]
    # What was never seen whole before does not come back.
    assert tracks(shown((1, 0), (1, 1)), ALWAYS) == [{1: 1}, {1: 1}]


def test_tracks_break_in_sight_as_often_as_asked():
    maps = torch.arange(1, 201).repeat(2, 2, 1)
    settings = BreakSettings(on_return=0.0, in_sight=0.25, min_pixels=1)
    broken = [old != new for old, new in tracks(maps, settings)[1].items()]
    assert 30 <= sum(broken) <= 70  # 50 expected of 200, deviation 6
    new = [new for frame in tracks(maps, settings) for new in frame.values()]
    assert len(set(new)) == 200 + sum(broken)


def test_frames_do_not_depend_on_which_are_read():
    rooms = BrokenTracks(FakeRooms(2, size=16), OFTEN)
    assert isinstance(rooms, SceneSource)
    whole = rooms.frames(1, range(16)).instances
    some = BrokenTracks(FakeRooms(2, size=16), OFTEN).frames(1, [9, 3])
    assert torch.equal(some.instances, whole[[9, 3]])
    other = BrokenTracks(FakeRooms(2, size=16), OFTEN, seed=1)
    assert not torch.equal(other.frames(1, range(16)).instances, whole)


def test_masks_keep_their_borders_and_without_breaks_their_ids():
    true = FakeRooms(1, size=16).frames(0, range(16))
    same = BrokenTracks(FakeRooms(1, size=16), NEVER).frames(0, range(16))
    assert torch.equal(same.instances, true.instances)
    assert torch.equal(same.images, true.images)
    often = BrokenTracks(FakeRooms(1, size=16), OFTEN).frames(0, range(16))
    assert len(often.instances.unique()) > len(true.instances.unique()) + 10
    for ids, wanted in zip(often.instances, true.instances, strict=True):
        pairs = torch.stack([ids.flatten(), wanted.flatten()]).unique(dim=1)
        assert pairs.shape[1] == len(ids.unique()) == len(wanted.unique())


def test_nothing_breaks_where_nothing_is():
    assert tracks(torch.zeros(0, 2, 2, dtype=torch.int64), ALWAYS) == []
    assert tracks(shown((0, -1)), ALWAYS) == [{}]
    empty = BrokenTracks(FakeRooms(1, size=16)).frames(0, [])
    assert empty.instances.shape == (0, 16, 16)


@pytest.mark.parametrize("wrong", [{"on_return": 1.1}, {"in_sight": -0.1}])
def test_probabilities_are_probabilities(wrong):
    with pytest.raises(ValueError, match=r"must be in \[0, 1\], got"):
        BreakSettings(**wrong)
