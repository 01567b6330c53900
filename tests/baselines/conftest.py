import pytest

import easy_room
from instok3d.data.sample import Sample
from instok3d.evaluation.methods import Shown


@pytest.fixture(scope="session")
def easy_sample() -> Sample:
    return easy_room.easy_sample()


@pytest.fixture(scope="session")
def easy_shown(easy_sample: Sample) -> Shown:
    return easy_room.easy_shown(easy_sample)
