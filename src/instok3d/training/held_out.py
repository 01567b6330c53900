"""Which scenes of a data set a run trains on, and which samples it is validated with."""

from typing import Protocol, runtime_checkable

from instok3d.data.batches import SceneSource, make_sample
from instok3d.data.sample import Sample, collate
from instok3d.data.view_sampling import eight_view_protocol, two_view_protocol


@runtime_checkable
class SeededSource(SceneSource, Protocol):
    """A data set that knows the seed of each of its scenes without reading it."""

    def seed_of(self, number: int, /) -> int:
        """What scene `number` was made from."""
        ...


def split_scenes(
    source: SeededSource, seeds: list[int], holdout: int
) -> tuple[list[int], list[int]]:
    """Scene numbers to hold out (the first `holdout` of the seeds) and to train on.

    Raises:
        ValueError: Nothing is left to train on or to look at, or a scene of the run is missing.
    """
    if holdout < 1:
        raise ValueError(f"holdout must be at least 1 scene to validate with, got {holdout}")
    if len(seeds) <= holdout:
        raise ValueError(
            f"the data set has {len(seeds)} scenes and {holdout} are held out: make more rooms"
        )
    place = {source.seed_of(number): number for number in range(len(source))}
    missing = [seed for seed in seeds if seed not in place]
    if missing:
        raise ValueError(
            f"the run was started with {len(missing)} scenes that the data set no longer has, "
            f"the first is seed {missing[0]}"
        )
    indices = [place[seed] for seed in seeds]
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
        scene = source.scene(index)
        protocol = two_view_protocol if views == 2 else eight_view_protocol
        singles.append(make_sample(scene, protocol(len(scene.images))))
    size = max(1, batch_size * 2 // views)
    return [collate(singles[k : k + size]) for k in range(0, len(singles), size)]
