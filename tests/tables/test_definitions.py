from dataclasses import replace

from instok3d.baselines.registry import METHODS
from instok3d.evaluation.figures import Figures
from instok3d.evaluation.semantic_lifting import KINDS
from instok3d.model.tokenizer import TokenizerConfig
from instok3d.tables.cells import Asked
from instok3d.tables.definitions import (
    FEATURE_KEYS,
    OWN,
    OnePass,
    PerScene,
    Tokenizer,
    tables,
    without_lpips,
)
from instok3d.tables.trainings import (
    C3G,
    JOINT,
    LSM,
    OURS,
    RENDERING,
    SEGMENTER,
    SEMANTICS,
    SEQUENTIAL,
    TRAININGS,
    UNI3R,
    UPDATE_S,
    Schedule,
    config_of,
    needed,
)

ALL = tables(("segmenter", "degraded", "true"))
SCHEDULE = Schedule(steps=100, seed=4, quick=False, teacher="rooms:x")


def test_every_entry_names_what_exists():
    assert list(ALL) == [1, 2, 3, 4, 5, 6, 7, 8]
    for table in ALL.values():
        labels = [row.label for row in table.rows]
        assert len(set(labels)) == len(labels)
        for column in table.columns:
            assert column.key in FEATURE_KEYS or column.key in Figures.__dataclass_fields__
        for row in table.rows:
            assert row.method or row.features
            assert row.without <= {column.key for column in table.columns}
            assert row.features is None or row.features in (*KINDS, OWN)
            if isinstance(row.method, Tokenizer | OnePass):
                assert row.method.training in {OURS, *TRAININGS}
            if isinstance(row.method, Tokenizer):
                assert {name for name, _ in row.method.changed} <= set(vars(TokenizerConfig()))
            assert (row.features == OWN) <= isinstance(row.method, OnePass)
            if isinstance(row.method, PerScene):
                assert row.method.method in METHODS


def test_rows_with_views_have_one_reference_on_the_same_scenes():
    for table in ALL.values():
        with_views = [row for row in table.rows if row.method is not None]
        for kind in {row.scenes for row in with_views}:
            (reference,) = (row for row in with_views if row.scenes == kind and row.reference)
            assert reference.label.startswith("Ours")


def test_masks_make_rows_that_name_them_and_true_ones_are_an_upper_bound():
    rows = {row.label: row for row in ALL[2].rows}
    assert rows["ObjectGS, masks true"].upper_bound
    row = rows["ObjectGS, masks segmenter, tracker predicted-depth"]
    assert row.method == PerScene("objectgs", "segmenter", "predicted-depth")
    assert not row.upper_bound
    assert row.pictured
    assert not rows["ObjectGS, masks true"].pictured
    assert Asked(row, 8, "views").trainings == (OURS, SEGMENTER)
    assert rows["ObjectGS, masks degraded, tracker true-depth"].method
    few = tables(("degraded", "true"), "none")[2].rows
    trackers = {row.method.tracker for row in few if isinstance(row.method, PerScene)}
    assert trackers == {None, "none", "true-ids"}


def test_a_table_without_lpips_has_no_such_column():
    assert [column.key for column in without_lpips(ALL[3]).columns] == [
        "psnr", "ssim", "ap", "ap50", "ap25"
    ]  # fmt: skip


def test_trainings_stand_behind_those_that_they_begin_with():
    assert needed([SEQUENTIAL, OURS], ()) == [RENDERING, SEQUENTIAL, JOINT]
    assert needed([SEMANTICS], ()) == [JOINT, SEMANTICS]
    assert needed([SEMANTICS, SEGMENTER], [OURS]) == [SEMANTICS, SEGMENTER]
    assert needed([OURS, SEMANTICS], [OURS, SEMANTICS]) == []
    assert needed([], ()) == []


def test_rivals_differ_in_one_thing_and_train_as_long():
    joint = config_of(JOINT, SCHEDULE)
    halves = [config_of(name, SCHEDULE) for name in (RENDERING, SEQUENTIAL)]
    assert sum(half.steps for half in halves) == joint.steps == 100
    assert [vars(half.stage)["trained"] for half in halves] == ["rendering", "grouping"]
    without = config_of("no-warmup", SCHEDULE)
    assert vars(without.stage)["seg_warmup_steps"] == 0 < vars(joint.stage)["seg_warmup_steps"]
    broken = config_of("broken-tracks", SCHEDULE)
    assert (broken.masks, joint.masks) == ("broken-tracks", None)
    assert broken.stage == joint.stage
    assert {c.seed for c in (joint, *halves, without, broken)} == {4}
    assert vars(config_of(SEMANTICS, SCHEDULE).stage)["teacher"] == "rooms:x"


def test_each_deviation_is_left_out_alone():
    left_out = {
        "no-anchor-loss": ({"assignment_weight": 0.0}, {}),
        "no-self-attention": ({}, {"anchor_self_attention": False, "group_self_attention": False}),
        "no-projection": ({}, {"project_assignment": False}),
    }
    named = {row.method.training for row in ALL[7].rows if isinstance(row.method, Tokenizer)}
    assert named == {JOINT, *left_out}
    for quick in (False, True):
        schedule = replace(SCHEDULE, quick=quick)
        stage = vars(config_of(JOINT, schedule).stage)
        for name, (of_stage, sizes) in left_out.items():
            other = config_of(name, schedule)
            expected = {**stage, **of_stage, "tokenizer": replace(stage["tokenizer"], **sizes)}
            assert vars(other.stage) == expected != stage
            assert other.steps == config_of(JOINT, schedule).steps


def test_other_models_train_in_the_time_of_ours_with_the_encoder_of_ours():
    joint, semantics = config_of(JOINT, SCHEDULE), config_of(SEMANTICS, SCHEDULE)
    assert semantics.steps == 40
    ours_s = joint.steps * UPDATE_S + semantics.steps * TRAININGS[SEMANTICS].update_s
    for name in (LSM, UNI3R, C3G):
        config = config_of(name, SCHEDULE)
        update_s = TRAININGS[name].update_s
        assert abs(config.steps * update_s - ours_s) <= update_s / 2
        assert vars(config.stage)["teacher"] == "rooms:x"
    segmenter = config_of(SEGMENTER, SCHEDULE).steps * TRAININGS[SEGMENTER].update_s
    assert abs(segmenter - joint.steps * UPDATE_S) < 1


def test_lsm_keeps_the_whole_width_of_the_encoder_and_uni3r_64_channels():
    wide = replace(SCHEDULE, channels=512)
    lsm, uni3r = (vars(config_of(name, wide).stage)["model"] for name in (LSM, UNI3R))
    assert (lsm.head.feature_channels, lsm.encoder_channels) == (512, 512)
    assert (uni3r.head.feature_channels, uni3r.encoder_channels) == (64, 512)
    assert vars(config_of(C3G, wide).stage)["model"].encoder_channels == 512
    assert vars(config_of(SEMANTICS, wide).stage)["tokens"].feature_channels == 512
