import numpy as np

from instok3d.datasets.pseudo_labels.statistics import StatisticsConfig, StatisticsOfClip


def statistics(rows: list[str], config: StatisticsConfig | None = None):
    """Of id maps of one row, a digit a pixel."""
    clip = StatisticsOfClip(config or StatisticsConfig())
    for row in rows:
        clip.add(np.array([[int(digit) for digit in row]], dtype=np.uint16))
    return clip.result()


def test_lengths_and_coverage_by_hand():
    found = statistics(["1100", "1120", "0020"])
    assert (found.frames, found.tracks) == (3, 2)
    assert found.mean_track_frames == (2 + 2) / 2
    assert found.coverage == (2 + 3 + 1) / 12


def test_an_id_that_ends_large_where_a_new_one_comes_up_is_a_break():
    assert statistics(["1111", "1111", "2222"]).breaks == 1
    assert statistics(["1111", "1111", "0000", "0222"]).breaks == 1  # IoU 3/4, one frame later
    assert statistics(["1111", "1111", "2222"]).breaks_per_track == 1 / 2


def test_ids_that_end_in_other_ways_are_no_breaks():
    assert statistics(["1111", "1111", "0000"]).breaks == 0  # nothing takes the place
    assert statistics(["1111", "1111", "0002"]).breaks == 0  # IoU 1/4
    assert statistics(["111111", "111111", "100000", "200000"]).breaks == 0  # it shrank before
    assert statistics(["1100", "1122", "1122"]).breaks == 0  # it goes on
    assert statistics(["1111", "2222", "1111"]).breaks == 0  # it comes back
    late = ["1111", *["0000"] * 5, "2222"]
    assert statistics(late).breaks == 0
    assert statistics(late, StatisticsConfig(break_frames=6)).breaks == 1


def test_a_newcomer_with_the_smaller_number_breaks_too():
    assert statistics(["2222", "2222", "1111"]).breaks == 1


def test_short_gaps_flicker_and_long_ones_are_returns():
    found = statistics(["1", "0", "1", "0", "0", "1", "0", "0", "0", "1"])
    assert (found.flickers, found.returns) == (2, 1)


def test_clips_without_frames_or_ids():
    nothing = statistics([])
    assert (nothing.frames, nothing.tracks, nothing.coverage, nothing.breaks) == (0, 0, 0, 0)
    assert statistics(["000"]).mean_track_frames == 0
