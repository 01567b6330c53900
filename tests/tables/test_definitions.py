from instok3d.baselines.registry import METHODS
from instok3d.evaluation.figures import Figures
from instok3d.evaluation.semantic_lifting import KINDS
from instok3d.tables.definitions import (
    FEATURE_KEYS,
    PerScene,
    Tokenizer,
    tables,
    without_lpips,
)
from instok3d.tables.trainings import (
    JOINT,
    OURS,
    RENDERING,
    SEMANTICS,
    SEQUENTIAL,
    TRAININGS,
    Schedule,
    config_of,
    needed,
)

ALL = tables(("true", "degraded"), "predicted-depth")
SCHEDULE = Schedule(steps=100, seed=4, quick=False, teacher="rooms:x")


def test_every_entry_names_what_exists():
    assert list(ALL) == [1, 2, 3, 4, 5, 6]
    for table in ALL.values():
        labels = [row.label for row in table.rows]
        assert len(set(labels)) == len(labels)
        for column in table.columns:
            assert column.key in FEATURE_KEYS or column.key in Figures.__dataclass_fields__
        for row in table.rows:
            assert row.method or row.features or row.not_built
            assert row.without <= {column.key for column in table.columns}
            assert row.features is None or row.features in KINDS
            if isinstance(row.method, Tokenizer):
                assert row.method.training in {OURS, *TRAININGS}
            if isinstance(row.method, PerScene):
                assert row.method.method in METHODS


def test_masks_make_rows_that_name_them_and_true_ones_are_an_upper_bound():
    rows = {row.label: row for row in ALL[2].rows}
    assert rows["ObjectGS, masks true"].upper_bound
    row = rows["ObjectGS, masks degraded, tracker predicted-depth"]
    assert row.method == PerScene("objectgs", "degraded", "predicted-depth")
    assert not row.upper_bound
    assert not any("masks true" in row.label for row in tables(("degraded",), "none")[2].rows)


def test_a_table_without_lpips_has_no_such_column():
    assert [column.key for column in without_lpips(ALL[3]).columns] == [
        "psnr", "ssim", "ap", "ap50", "ap25"
    ]  # fmt: skip


def test_trainings_stand_behind_those_that_they_begin_with():
    assert needed([SEQUENTIAL, OURS], False, False) == [RENDERING, SEQUENTIAL, JOINT]
    assert needed([SEMANTICS], False, False) == [JOINT, SEMANTICS]
    assert needed([SEMANTICS], True, False) == [SEMANTICS]
    assert needed([OURS, SEMANTICS], True, True) == []
    assert needed([], False, False) == []


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
