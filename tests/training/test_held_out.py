import pytest

from instok3d.training.held_out import hold_out_last


@pytest.mark.parametrize(
    ("count", "kept"), [(0, 0), (1, 1), (2, 1), (20, 19), (448, 426), (920, 874)]
)
def test_the_last_twentieth_of_the_scenes_is_held_out(count: int, kept: int):
    training, held_out = hold_out_last(count)
    assert training == range(kept)
    assert held_out == range(kept, count)
