import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.sample import Sample

CONFIG = BatchConfig(batch_size=2, views=(2, 2, 3))


def batches(*, seed: int = 0, rank: int = 0, world_size: int = 1, config=CONFIG) -> SceneBatches:
    return SceneBatches(
        FakeRooms(5, size=16), range(5), config, seed=seed, rank=rank, world_size=world_size
    )


def same(a: Sample, b: Sample) -> bool:
    return a.names == b.names and torch.equal(a.context.images, b.context.images)


def test_batch_depends_on_seed_step_and_rank_alone():
    used, fresh = batches(), batches()
    for step in range(4):
        used.batch(step)
    assert same(used.batch(9), fresh.batch(9))
    assert not same(fresh.batch(9), fresh.batch(10))
    assert not same(fresh.batch(9), batches(seed=1).batch(9))


def test_two_ranks_share_the_batch_of_one():
    whole = batches(config=BatchConfig(batch_size=4)).batch(3)
    half = BatchConfig(batch_size=2)
    parts = [batches(rank=rank, world_size=2, config=half).batch(3) for rank in range(2)]
    assert parts[0].names + parts[1].names == whole.names
    assert parts[0].names != parts[1].names
    joined = torch.cat([part.context.images for part in parts])
    assert torch.equal(joined, whole.context.images)


def test_an_epoch_sees_every_scene_once():
    one = batches(config=BatchConfig(batch_size=1))
    seeds = [one.batch(step).names[0].split()[0] for step in range(10)]
    assert sorted(seeds[:5]) == sorted(seeds[5:]) == list("01234")


def test_reading_ahead_gives_the_same_batches_in_order():
    direct, ahead = batches(), batches().iterate(6)
    for expected in (6, 7, 8):
        step, sample = next(ahead)
        assert step == expected
        assert same(sample, direct.batch(expected))


def test_more_views_make_smaller_batches():
    config = BatchConfig(batch_size=4, views=(8,))
    assert batches(config=config).batch(0).context.images.shape[:2] == (1, 8)


def test_photometric_change_is_one_for_all_views_of_a_scene():
    plain = batches(config=BatchConfig(batch_size=1, photometric=False)).batch(0)
    changed = batches(config=BatchConfig(batch_size=1, photometric=True)).batch(0)
    assert changed.names == plain.names
    assert changed.target.depths is not None
    assert plain.target.depths is not None
    assert torch.equal(changed.target.depths, plain.target.depths)
    # Target 1 is one of the contexts; the two differ by the noise of the context alone, and the
    # change itself is larger than that.
    new = changed.target.images[0, 1]
    nearest = min((new - c).abs().mean().item() for c in changed.context.images[0])
    assert nearest < 0.02
    assert (new - plain.target.images[0, 1]).abs().mean() > nearest


def test_no_scene_and_wrong_rank_are_refused():
    with pytest.raises(ValueError, match="at least one scene"):
        SceneBatches(FakeRooms(1), [], CONFIG, seed=0)
    with pytest.raises(ValueError, match=r"rank must be in 0\.\.1"):
        batches(rank=2, world_size=2)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"batch_size": 0}, "batch_size must be at least 1, got 0"),
        ({"views": ()}, r"at least 2, got \(\)"),
        ({"views": (2, 1)}, r"at least 2, got \(2, 1\)"),
        ({"num_targets": 0}, "num_targets must be at least 1"),
    ],
)
def test_settings_that_give_no_batch_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        BatchConfig(**settings)
