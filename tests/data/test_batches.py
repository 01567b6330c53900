from dataclasses import replace

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import BatchConfig, NoBaselineError, SceneBatches, make_sample
from instok3d.data.sample import Sample
from instok3d.data.view_sampling import FrameChoice

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
        step, (sample,) = next(ahead)
        assert step == expected
        assert same(sample, direct.batch(expected))


@pytest.mark.parametrize("readers", [1, 2, 5])
def test_any_number_of_readers_gives_the_same_parts_in_order(readers):
    one = SceneBatches(FakeRooms(5, size=16), range(5), CONFIG, seed=0, accumulate=2)
    stream = one.iterate(3, readers)
    for expected in (3, 4, 5):
        step, parts = next(stream)
        assert step == expected
        assert len(parts) == 2
        assert all(same(part, one.batch(step, k)) for k, part in enumerate(parts))
    with pytest.raises(ValueError, match="readers must be at least 1, got 0"):
        next(one.iterate(0, 0))


def test_parts_of_a_step_are_shared_out_between_ranks():
    """One process in four parts, two in two, and four in one see the same samples."""
    small = BatchConfig(batch_size=1)

    def names(world_size: int, accumulate: int) -> list[str]:
        ranks = [
            SceneBatches(
                FakeRooms(5, size=16), range(5), small, seed=0,
                rank=rank, world_size=world_size, accumulate=accumulate,
            )
            for rank in range(world_size)
        ]  # fmt: skip
        return [rank.batch(2, part).names[0] for rank in ranks for part in range(accumulate)]

    assert names(1, 4) == names(2, 2) == names(4, 1)
    assert len(set(names(1, 4))) == 4


@pytest.mark.parametrize(("views", "scenes", "targets"), [(2, 4, 2), (4, 2, 4), (8, 1, 8)])
def test_more_views_make_smaller_batches_of_as_many_pictures(views, scenes, targets):
    sample = batches(config=BatchConfig(batch_size=4, views=(views,), num_targets=2)).batch(0)
    assert sample.context.images.shape[:2] == (scenes, views)
    assert sample.target.images.shape[:2] == (scenes, targets)


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
        ({"views": (2, 4), "sampling": "re10k"}, r"2 context views, got views \(2, 4\)"),
    ],
)
def test_settings_that_give_no_batch_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        BatchConfig(**settings)


class LongRooms(FakeRooms):
    """The frames of a fake room there and back again; the first so many cameras stand still."""

    def __init__(self, lengths: list[int], still: int = 0):
        super().__init__(len(lengths), size=8)
        self.lengths, self.still = lengths, still

    def num_frames(self, number):
        return self.lengths[number]

    def frames(self, number, chosen):
        scene = super().frames(number, [min(k % 32, 31 - k % 32) for k in chosen])
        poses = scene.world_from_cam.clone()
        poses[torch.tensor([k < self.still for k in chosen])] = torch.eye(4, dtype=poses.dtype)
        return replace(scene, world_from_cam=poses)


def test_each_rule_of_sampling_reaches_the_batch():
    scannet = BatchConfig(1, views=(8,), num_targets=7, sampling="scannet")
    sample = SceneBatches(FakeRooms(1, size=8), [0], scannet, seed=0).batch(0)
    assert sample.names[0].endswith(("0,2,4,6,8,10,12,14", "1,3,5,7,9,11,13,15"))
    assert sample.target.images.shape[:2] == (1, 7)
    re10k = BatchConfig(1, sampling="re10k", unit="baseline", num_targets=3)
    clips = SceneBatches(LongRooms([200]), [0], re10k, seed=0)
    for step, gaps in ((0, [25]), (10**6, range(45, 91))):
        names = [clips.batch(step + k).names[0] for k in range(5)]
        pairs = [name.split()[-1].split(",") for name in names]
        assert all(int(b) - int(a) in gaps for a, b in pairs)


def test_baseline_as_unit_puts_the_second_context_one_unit_away():
    source, choice = FakeRooms(1, size=8), FrameChoice((2, 7), (4,))
    metres = make_sample(source, 0, choice)
    units = make_sample(source, 0, choice, unit="baseline")
    # Frames of a fake room are 0.06 m apart: five frames are 0.3 m, which is now 1.
    assert units.context.cam_from_world is not None
    assert metres.context.cam_from_world is not None
    place = units.context.cam_from_world[0, 1, :3, 3]
    assert place.norm() == pytest.approx(1.0, abs=1e-6)
    assert torch.allclose(place * 0.3, metres.context.cam_from_world[0, 1, :3, 3], atol=1e-6)
    rotations = [s.context.cam_from_world[..., :3, :3] for s in (units, metres)]
    assert torch.equal(*rotations)
    for part in ("context", "target"):
        unit_depths, depths = getattr(units, part).depths, getattr(metres, part).depths
        assert torch.allclose(unit_depths * 0.3, depths, rtol=1e-5)


def test_contexts_at_one_place_are_drawn_again():
    config = BatchConfig(1, sampling="scannet", unit="baseline", photometric=False)
    with pytest.raises(NoBaselineError, match="contexts 1 and 3 of scene 0 stand 0 apart"):
        make_sample(LongRooms([30], still=9), 0, FrameChoice((1, 3), (2,)), unit="baseline")
    moving = SceneBatches(LongRooms([16], still=5), [0], config, seed=0)
    for step in range(12):
        assert max(map(int, moving.batch(step).names[0].split()[-1].split(","))) >= 5


def test_a_scene_whose_camera_stands_still_is_replaced_by_the_next_with_a_warning():
    config = BatchConfig(1, sampling="scannet", unit="baseline")
    mixed = SceneBatches(LongRooms([5, 16], still=5), [0, 1], config, seed=0)
    with pytest.warns(UserWarning, match=r"scene 0 stand 0 apart; the next scene is taken"):
        assert {mixed.batch(step).names[0].split()[0] for step in range(4)} == {"1"}
    never = SceneBatches(LongRooms([5, 5], still=5), [0, 1], config, seed=0)
    with (
        pytest.warns(UserWarning, match="the next scene is taken"),
        pytest.raises(NoBaselineError, match="contexts of 2 scenes one after the other"),
    ):
        never.batch(0)


def test_scenes_too_short_for_a_sample_are_left_out_with_a_warning():
    config = BatchConfig(1, views=(2, 8), sampling="scannet")
    with pytest.warns(UserWarning, match="2 of 3 scenes are left out: .* the 15 frames"):
        kept = SceneBatches(LongRooms([14, 15, 3]), range(3), config, seed=0)
    assert kept.scenes == (1,)
    with pytest.raises(ValueError, match="all 1 scenes have fewer than the 46 frames"):
        SceneBatches(LongRooms([45]), [0], BatchConfig(sampling="re10k"), seed=0)


def test_a_batch_of_no_parts_is_refused():
    with pytest.raises(ValueError, match="accumulate must be at least 1, got 0"):
        SceneBatches(FakeRooms(2, size=32), [0, 1], BatchConfig(2), seed=0, accumulate=0)
