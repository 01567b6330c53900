import pytest

from flat_rooms import FlatRooms
from instok3d.data.batches import make_sample
from instok3d.data.sample import Sample
from instok3d.data.view_sampling import FrameChoice


@pytest.fixture(scope="session")
def flat_sample() -> Sample:
    return make_sample(FlatRooms([0], ["easy"]), 0, FrameChoice((7, 9), (8,)))
