"""Which scenes of a data set a run trains on, and which samples it is validated with."""

from dataclasses import replace

from instok3d.data.batches import make_sample
from instok3d.data.sample import Sample, collate
from instok3d.data.scenes import SceneSource
from instok3d.data.view_sampling import eight_view_protocol, two_view_protocol


def split_scenes(
    source: SceneSource, names: list[str], holdout: int
) -> tuple[list[int], list[int]]:
    """Scene numbers to hold out (the first `holdout` of the names) and to train on.

    Raises:
        ValueError: Nothing is left to train on or to look at, or a scene of the run is missing.
    """
    if holdout < 1:
        raise ValueError(f"holdout must be at least 1 scene to validate with, got {holdout}")
    if len(names) <= holdout:
        raise ValueError(
            f"the data set has {len(names)} scenes and {holdout} are held out: add scenes or lower "
            "holdout"
        )
    place = {source.name_of(number): number for number in range(len(source))}
    missing = [name for name in names if name not in place]
    if missing:
        raise ValueError(
            f"the run was started with {len(missing)} scenes that the data set no longer has, "
            f"the first is {missing[0]}"
        )
    indices = [place[name] for name in names]
    return indices[:holdout], indices[holdout:]


def validation_samples(
    source: SceneSource, scenes: list[int], views: int, batch_size: int = 4
) -> list[Sample]:
    """The same frames of the same scenes every time, in batches.

    Raises:
        ValueError: There is no protocol for this number of views.
    """
    if views not in (2, 8):
        raise ValueError(f"validation_views must hold 2 or 8, got {views}")
    singles = []
    for index in scenes:
        protocol = two_view_protocol if views == 2 else eight_view_protocol
        sample = make_sample(source, index, protocol(source.num_frames(index)))
        singles.append(replace(sample, keys=(f"{source.name_of(index)}/{views}/validation",)))
    size = max(1, batch_size * 2 // views)
    return [collate(singles[k : k + size]) for k in range(0, len(singles), size)]


HELD_OUT_SHARE = 0.05
"""Of the rooms of each folder: validate the teacher and choose thresholds of labels."""


def hold_out_last(count: int) -> tuple[range, range]:
    """Numbers of the scenes of one data set to train on, and of the last ones, to hold out."""
    held_out = max(1, round(count * HELD_OUT_SHARE)) if count > 1 else 0
    return range(count - held_out), range(count - held_out, count)
