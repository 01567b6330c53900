from dataclasses import replace

import pytest
import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import SceneBatches
from instok3d.training.config import preset
from instok3d.training.cost.estimate import (
    PEAK_TFLOPS,
    UTILISATION,
    checkpoint_bytes,
    disk_bytes,
    flop_per_batch,
    flop_per_sample,
    hours,
    model_on_paper,
    parts_of,
    samples_per_batch,
    targets_of,
)
from instok3d.training.cost.plan import PlannedScenes, make_plan, plan_text
from instok3d.training.cost.scene_check import check_scenes


class Rooms(FakeRooms):
    """Fake rooms that may lack ids or depth, or say that they have other numbers of frames."""

    def __init__(self, counts=(16, 16, 16), *, ids=True, depths=True, size=32):
        super().__init__(len(counts), size=size)
        self.counts, self.ids, self.depths = counts, ids, depths

    def num_frames(self, number: int) -> int:
        return self.counts[number]

    def frames(self, number, chosen):
        frames = super().frames(number, [k % 16 for k in chosen])
        if not self.ids:
            frames = replace(frames, instances=torch.full_like(frames.instances, -1))
        return frames if self.depths else replace(frames, depths_m=0 * frames.depths_m)


class Large(Rooms):
    """The same rooms with every pixel eight times as wide and high."""

    def frames(self, number, chosen):
        frames = super().frames(number, chosen)
        names = ("images", "instances", "depths_m")
        return replace(frames, **{n: _enlarged(getattr(frames, n)) for n in names})


def _enlarged(maps: torch.Tensor) -> torch.Tensor:
    return maps.repeat_interleave(8, dim=1).repeat_interleave(8, dim=2)


def small(name: str, **changes):
    return replace(preset(name), holdout=1, **changes)


def test_a_plan_on_paper_takes_no_memory_and_counts_like_the_model():
    model = model_on_paper(preset("nano-tokenizer"))
    assert all(p.is_meta for p in model.parameters())
    parts = {part.name: part for part in parts_of(model)}
    assert parts["backbone"].trained == 0 < parts["backbone"].frozen
    own = sum(p.numel() for p in model.own_parameters())
    assert sum(part.trained for part in parts.values()) == own


def test_work_of_a_geometry_step_by_hand():
    # 2 views of 32 x 32 have 32 patches of 8 x 8: 2 operations for each parameter and patch, and
    # twice as many again on the way back.
    config = preset("nano-geometry")
    model = model_on_paper(config)
    size = sum(p.numel() for p in model.parameters())
    assert flop_per_sample(config, model, 2, 32, 32) == 2 * size * 32 * 3
    # batches of 4 with 2 views and of 1 with 8: four times the views, a quarter of the samples
    mixed = replace(config, batches=replace(config.batches, views=(2, 8)))
    assert [samples_per_batch(mixed, views) for views in (2, 8)] == [4, 1]
    assert flop_per_batch(mixed, model, 32, 32) == 4 * 2 * size * 32 * 3


def test_a_frozen_backbone_costs_a_third():
    config = preset("nano-tokenizer")
    model = model_on_paper(config)
    learning = replace(config, stage=replace(config.stage, freeze_backbone=False))
    backbone = sum(p.numel() for p in model.backbone.parameters())
    more = flop_per_sample(learning, model_on_paper(learning), 2, 32, 32)
    assert more - flop_per_sample(config, model, 2, 32, 32) == 2 * 2 * backbone * 32


def test_hours_by_hand():
    # A petaflop a second at UTILISATION of its peak: 4 GPUs of 312 TFLOP/s.
    flop = 4 * 312e12 * UTILISATION * 7200
    assert hours(flop, num_gpus=4, gpu="a100") == pytest.approx(2.0)
    with pytest.raises(ValueError, match="no peak is known of the GPU 'k80'"):
        hours(flop, num_gpus=4, gpu="k80")
    with pytest.raises(ValueError, match="at least 1, got 0"):
        hours(flop, num_gpus=0, gpu="a100")
    assert all(each > 100 for each in PEAK_TFLOPS.values())


def test_disk_holds_two_checkpoints_and_the_one_being_written():
    model = torch.nn.Sequential(torch.nn.Linear(10, 1), torch.nn.Linear(5, 1))
    model[1].requires_grad_(False)
    # 11 + 6 weights; two moments and an average of the 11 that learn; 4 bytes each.
    assert checkpoint_bytes(model) == 4 * (17 + 33)
    assert disk_bytes(model) == 3 * 4 * (17 + 33)
    assert checkpoint_bytes(model, averaged=False) == 4 * (17 + 22)


def test_targets_follow_the_rule_of_the_data_set():
    assert targets_of(preset("scannet-2view"), 2) == 3
    assert targets_of(preset("scannet-8view"), 8) == 7
    assert [targets_of(preset("nano-tokenizer"), views) for views in (2, 8)] == [1, 4]
    for name, views in (("scannet-2view", 2), ("scannet-8view", 8), ("re10k-2view", 2)):
        batches = replace(preset(name).batches, batch_size=views // 2, sampling="scannet")
        drawn = SceneBatches(Rooms((16,)), [0], batches, seed=0).batch(0)
        assert drawn.target.images.shape[1] == targets_of(preset(name), views)


def test_scenes_that_are_too_short_are_counted_and_left_out():
    source = Rooms((16, 16, 2, 14, 16))  # one is held out; 8 views want 15 frames
    config = small("nano-tokenizer")
    config = replace(config, batches=replace(config.batches, views=(2, 8)))
    plan = make_plan(config, source, num_gpus=1, gpu="a6000", init_from=None)
    assert plan.data == PlannedScenes(scenes=2, held_out=1, too_short=2, frames=32)
    with pytest.raises(ValueError, match=r"no scene is left .* 2 have fewer than 15 frames"):
        make_plan(config, Rooms((16, 3, 4)), num_gpus=1, gpu="a6000", init_from=None)


def test_learning_rates_are_those_of_the_schedule():
    config = small("nano-tokenizer", steps=1_000)
    plan = make_plan(config, Rooms(), num_gpus=1, gpu="a6000", init_from=None)
    rates = dict(plan.rates)
    assert sorted(rates) == [0, 100, 550, 999]
    assert rates[0] == pytest.approx(1e-6)  # 1e-4 / 100
    assert rates[100] == pytest.approx(1e-4)
    assert rates[550] == pytest.approx(0.5 * (1e-4 + 1e-6))


def test_what_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path))
    config = small("nano-tokenizer")
    config = replace(config, stage=replace(config.stage, lpips_weight=0.05))

    def missing(**arguments) -> str:
        plan = make_plan(config, Rooms(), num_gpus=1, gpu="a6000", **arguments)
        return "; ".join(plan.missing)

    assert "instok3d models pull lpips-vgg16" in missing(init_from=None)
    assert "--init-from" in missing(init_from=None)
    assert "--init-from" not in missing(init_from=tmp_path)
    assert "--init-from" not in missing(init_from=None, resume=True)
    assert "no run folder" in missing(init_from=tmp_path / "nowhere")
    config = replace(config, stage=replace(config.stage, lpips_file=tmp_path / "x"))
    assert "no LPIPS weights at" in missing(init_from=tmp_path)


def test_scenes_without_ids_are_refused_by_the_tokenizer_alone():
    with pytest.raises(ValueError, match=r"has no instance ids.*choose them with --masks"):
        check_scenes(small("nano-tokenizer"), Rooms(ids=False))
    config = small("nano-tokenizer")
    check_scenes(replace(config, stage=replace(config.stage, seg_weight=0.0)), Rooms(ids=False))
    assert check_scenes(small("nano-adapt"), Rooms(ids=False)) == (32, 32)


def test_scenes_without_depth_are_refused_by_the_geometry_stage_alone():
    with pytest.raises(ValueError, match="has no true depth"):
        check_scenes(small("nano-geometry"), Rooms(depths=False))
    check_scenes(small("nano-tokenizer"), Rooms(depths=False))


def test_no_scene_and_pictures_of_several_sizes_are_refused():
    with pytest.raises(ValueError, match="no scene of the training split"):
        check_scenes(small("nano-geometry"), Rooms(()))

    class Mixed(Rooms):
        def frames(self, number, chosen):
            self.size = 32 + 8 * number
            return super().frames(number, chosen)

    with pytest.raises(ValueError, match=r"one size, the data set has \[\(32, 32\)"):
        check_scenes(small("nano-geometry"), Mixed())


def test_the_papers_run_is_planned_without_its_weights(tmp_path, monkeypatch):
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path))
    source = Large((60, 60, 60))
    plan = make_plan(small("scannet-2view"), source, num_gpus=4, gpu="a6000", init_from=None)
    text = plan_text(plan, gpu="a6000")
    assert plan.samples_per_update == 32
    assert "32 samples = 4 in a batch x 2 accumulated x 4 processes\n" in text
    assert "135.37 M parameters: fuse 3.68 M" in text
    assert plan.parts[0].name == "backbone"
    assert plan.parts[0].frozen == pytest.approx(1190.7e6, rel=1e-3)
    assert 10 < plan.hours < 40  # the paper: 20
    assert plan.memory_bytes < 48e9  # of an A6000
    assert "instok3d models pull lpips-vgg16" in text
    eight = make_plan(small("scannet-8view"), source, num_gpus=4, gpu="h200", init_from=None)
    assert 6 < eight.hours < 24  # the paper: 12
    assert eight.samples_per_update == 32
    adapt = make_plan(small("scannet-adapt"), source, num_gpus=4, gpu="h200", init_from=None)
    assert adapt.hours < 6  # as in the paper
    assert "vggt-1b" in plan_text(adapt, gpu="h200")


@pytest.mark.parametrize(
    ("name", "needed", "command"),
    [
        ("scannet-2view", "scenes of ScanNet of at least 3 frames, with instance ids", "scannet"),
        ("scannet-adapt", "scenes of ScanNet of at least 3 frames; the first 8", "scannet"),
        ("re10k-2view", "scenes of RealEstate10K of at least 46 frames, with masks by", "re10k"),
        (
            "nano-geometry",
            "rendered rooms (1.8 MB each) of at least 15 frames, with depth",
            "rooms",
        ),
    ],
)
def test_without_scenes_the_plan_says_which_it_needs_and_what_it_takes(name, needed, command):
    plan = make_plan(preset(name), None, num_gpus=4, gpu="a6000", init_from=None)
    text = plan_text(plan, gpu="a6000")
    assert f"none yet; needed are {needed}" in text
    assert f"instok3d data {'' if command == 'rooms' else 'prepare '}{command}" in plan.missing[0]
    assert ("data masks DIR --model sam2" in plan.missing[0]) == (name == "re10k-2view")
    assert "of each scene" not in text


def test_a_plan_without_scenes_counts_as_one_with_scenes_of_the_papers_size():
    config = small("scannet-2view")
    with_them = make_plan(config, Large((60, 60, 60)), num_gpus=4, gpu="a6000", init_from=None)
    without = make_plan(config, None, num_gpus=4, gpu="a6000", init_from=None)
    assert (without.height, without.width) == (256, 256)
    for name in ("hours", "memory_bytes", "disk_bytes", "samples", "parts", "rates"):
        assert getattr(with_them, name) == getattr(without, name)
    assert without.missing[1:] == with_them.missing
