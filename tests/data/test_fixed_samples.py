import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import BatchConfig, SceneBatches


def batches(config: BatchConfig) -> SceneBatches:
    return SceneBatches(FakeRooms(5, size=16), range(5), config, seed=0)


def test_fixed_samples_come_again_after_as_many_epochs_as_there_are():
    config = BatchConfig(batch_size=5, samples_per_scene=2)
    first, second, third = (batches(config).batch(step) for step in range(3))
    assert set(first.keys) == {f"{scene}/2/0" for scene in range(5)}
    assert set(second.keys) == {f"{scene}/2/1" for scene in range(5)}
    assert set(third.keys) == set(first.keys)
    assert not set(first.names) <= set(second.names)
    # Equal keys mean equal samples, photometric change included, at whatever place of the batch.
    again = dict(zip(third.keys, third.context.images, strict=True))
    for key, image in zip(first.keys, first.context.images, strict=True):
        assert torch.equal(again[key], image)


def test_a_fixed_sample_follows_from_the_name_of_its_scene_not_from_its_number():
    config = BatchConfig(samples_per_scene=2)
    among_five = batches(config).fixed_sample(3, 2, 1)
    alone = SceneBatches(FakeRooms(1, size=16, first_seed=3), [0], config, seed=0)
    assert torch.equal(among_five.context.images, alone.fixed_sample(0, 2, 1).context.images)
    assert among_five.keys == ("3/2/1",)


def test_samples_drawn_anew_have_no_key():
    assert batches(BatchConfig()).batch(0).keys == ()
    with pytest.raises(ValueError, match="samples_per_scene must be None or at least 1, got 0"):
        BatchConfig(samples_per_scene=0)
