"""The whole command at toy sizes; what is killed goes on and gives the same figures."""

import json
import re
from pathlib import Path

import pytest
import torch

from capture_folders import write_capture
from instok3d.backbones.nano import pair_cameras
from instok3d.baselines import registry
from instok3d.cli import main
from instok3d.tables import measuring
from instok3d.tables.cells import asked_of, cell_path, read_cell
from instok3d.tables.definitions import tables, without_lpips
from instok3d.tables.measuring import measure
from instok3d.tables.run import make_tables
from instok3d.tables.trainings import RENDERING, SEQUENTIAL, Schedule
from instok3d.tables.work import Work
from kill_points import every_kill

EVERY = {n: without_lpips(table) for n, table in tables(("true",)).items()}


MADE = (1, 2, 4, 6, 8)
"""Tables 3, 5 and 7 have rows of the same kinds, of seven more trainings."""


@pytest.fixture(scope="module")
def made(rooms, tmp_path_factory) -> Path:
    """Tables of the toy rooms."""
    folder = tmp_path_factory.mktemp("made")
    captures = write_capture(folder / "captures" / "flat", 4).parent
    words = ["tables", *map(str, MADE), "--data", str(rooms), "--captures", str(captures)]
    words += ["--quick", "--scenes", "1", "--masks", "segmenter", "--threads", "1"]
    with pytest.MonkeyPatch.context() as patch:
        # Cameras of networks with random weights are wrong after any number of rounds.
        for name in ("ROUNDS_ALONE", "SUBSAMPLED_ROUNDS", "FULL_ROUNDS"):
            patch.setattr(pair_cameras, name, 1)
        assert main([*words, "-o", str(folder / "out")]) == 0
    return folder / "out"


def test_tables_are_written_with_what_stands_behind_every_row(made):
    for number in MADE:
        value = json.loads((made / f"table{number}.json").read_text())
        assert value["rows"]
        for row in value["rows"]:
            assert row["cells"]
            for name, cell in row["cells"].items():
                assert cell["scenes"] == 1
                assert re.fullmatch("[0-9a-f]{64}", cell["scenes_sha256"])
                assert cell["command"].split()[0] == "instok3d"
                assert (made / row["files"][name]).is_file()
        text = (made / f"table{number}.md").read_text()
        assert "QUICK: toy sizes" in text
        assert "nan" not in text.lower()
        assert r"\bottomrule" in (made / f"table{number}.tex").read_text()
    for name in ("figure3_reconstruction", "figure4_features", "figure5_instances"):
        assert (made / f"{name}.png").stat().st_size > 1000


def test_what_two_tables_need_is_made_once(made):
    rows = {n: json.loads((made / f"table{n}.json").read_text())["rows"] for n in MADE}
    files = {n: {row["label"]: row["files"] for row in rows[n]} for n in MADE}
    assert files[1]["Ours"]["views"] == files[6]["Ours, test"]["views"]
    assert files[1]["Uni3R style"]["views"] == files[6]["Uni3R style, test"]["views"]
    assert files[1]["Ours"]["features"] == files[4]["Anchor"]["features"]
    assert files[1]["Uni3R style"]["features"] != files[1]["LSM style"]["features"]
    assert files[2]["Ours"]["views"] == files[8]["Ours"]["views"]
    assert len(list((made / "masks").rglob("*.safetensors"))) == 1  # of three methods
    names = sorted(p.name.rpartition("-")[0] for p in (made / "trained").iterdir())
    assert names == ["c3g-style", "joint", "lsm-style", "segmenter", "semantics", "uni3r-style"]


def test_settings_that_are_changed_after_training_are_measured(made):
    rows = json.loads((made / "table8.json").read_text())["rows"]
    found = {row["label"]: row["cells"]["views"]["figures"]["psnr"] for row in rows}
    assert found["all views at once, no windows"] != found["Ours"]


def test_a_second_call_trains_and_measures_nothing(made, rooms, monkeypatch, capsys):
    def refused(*_: object, **__: object):
        raise AssertionError("it is there already")

    monkeypatch.setattr("instok3d.tables.trained.train", refused)
    monkeypatch.setattr("instok3d.tables.measuring.score_scene", refused)
    before = (made / "table1.md").read_bytes()
    words = ["tables", "1", "--data", str(rooms), "--quick", "--scenes", "1", "-o", str(made)]
    words += ["--threads", "2"]
    assert main([*words, "--resume"]) == 0
    assert (made / "table1.md").read_bytes() == before
    capsys.readouterr()
    assert main([*words, "--dry-run"]) == 0
    assert "0 of 13 steps are left, about 0.0 hours" in capsys.readouterr().out
    # Another seed is another training.
    assert main([*words, "--seed", "1", "--dry-run"]) == 0
    assert "13 of 13 steps are left" in capsys.readouterr().out


def test_a_folder_with_tables_is_not_written_to_unasked(made, rooms, capsys):
    words = ["tables", "3", "--data", str(rooms), "--quick", "-o", str(made)]
    assert main(words) == 2
    assert "is not empty: pass --resume to go on" in capsys.readouterr().err


def test_damaged_weights_are_noticed(made, rooms, capsys):
    (model,) = (made / "trained").glob("uni3r-style-*/model.safetensors")
    content = model.read_bytes()
    model.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    words = ["tables", "1", "--data", str(rooms), "--quick", "--resume", "--scenes", "1"]
    words += ["-o", str(made)]
    assert main(words) == 2
    assert "not the weights that were written); remove the folder" in capsys.readouterr().err
    model.write_bytes(content)


def test_the_plan_names_everything_and_writes_nothing(rooms, tmp_path, capsys):
    words = ["tables", "all", "--data", str(rooms), "-o", str(tmp_path / "out"), "--dry-run"]
    assert main([*words, "--scenes", "2"]) == 0
    text = capsys.readouterr().out
    assert "train joint: 3000 updates" in text
    assert "train sequential: 1500 updates" in text
    assert "train broken-tracks: 3000 updates, masks broken-tracks" in text
    assert "measure Table 6, Ours, held-out materials: 2 scenes" in text
    assert "train c3g-style: 1581 updates" in text
    assert "measure Table 5, C3G style: 2 scenes" not in text  # the same as in Table 1
    assert "missing  Table 6 asks for captures of real rooms" in text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["6"], "give a folder of them with --captures DIR"),
        (["3", "--steps", "0"], "--steps must be at least 1, got 0"),
        (["3", "--scenes", "0"], "--scenes must be at least 1, got 0"),
        (["3", "--scenes", "9"], "has no room with seed 2000002"),
        (["1", "--semantics", "x"], "name it with --model"),
        (["2", "--model", "nowhere.safetensors"], "there is no file nowhere.safetensors"),
    ],
)
def test_what_cannot_be_made_is_refused_in_one_sentence(words, message, rooms, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["tables", *words, "--data", str(rooms), "--quick", "-o", str(out)]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def quick_work(rooms: Path, folder: Path) -> Work:
    return Work(folder, (rooms,), Schedule(1, 0, True, "rooms:none"))


def test_no_table_asks_for_nothing(rooms, tmp_path):
    assert make_tables(quick_work(rooms, tmp_path / "out"), []) == []


def test_a_scene_that_cannot_be_measured_ends_the_command(rooms, tmp_path, monkeypatch):
    class Blind:
        needs = frozenset()

        def fit(self, shown: object) -> object:
            raise ValueError("it sees nothing")

    monkeypatch.setitem(registry.METHODS, "3dgs", lambda _: Blind())
    asked = asked_of(EVERY[2])[0][1][0]
    with pytest.raises(ValueError, match=r"2000000 .* cannot be measured: it sees nothing"):
        measure(quick_work(rooms, tmp_path), asked, "3dgs")
    assert not list((tmp_path / "cells").glob("*.json"))


@pytest.mark.filterwarnings("ignore:.*fork")
def test_killed_anywhere_measuring_goes_on_and_gives_the_same_figures(rooms, tmp_path):
    asked = asked_of(EVERY[2])[2][1][0]  # ObjectGS with true masks
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    straight = measure(quick_work(rooms, tmp_path / "straight"), asked, "straight").figures
    numbers = iter(range(1000))

    def prepare() -> Path:
        folder = tmp_path / f"killed{next(numbers)}"
        folder.mkdir()
        return folder

    timed = {"fit_s", "picture_s"}
    for folder in every_kill(
        prepare, lambda folder: measure(quick_work(rooms, folder), asked, "killed"), step=23
    ):
        kept = {part: part.stat().st_mtime_ns for part in folder.glob("cells/*/*.json")}
        figures = measure(quick_work(rooms, folder), asked, "again").figures
        assert {n: v for n, v in figures.items() if n not in timed} == {
            n: v for n, v in straight.items() if n not in timed
        }
        assert all(part.stat().st_mtime_ns == when for part, when in kept.items())
        assert read_cell(cell_path(quick_work(rooms, folder), asked)).scenes == 2
    torch.set_num_threads(threads)


def test_a_training_that_was_interrupted_goes_on(rooms, tmp_path, monkeypatch):
    from instok3d.tables import trained
    from instok3d.training.loop import TrainOutcome

    work, calls, whole = quick_work(rooms, tmp_path), [], trained.train

    def once(*given: object, **more: object) -> TrainOutcome:
        calls.append(more["resume"])
        outcome = whole(*given, **more)  # type: ignore[arg-type]
        return TrainOutcome(outcome.step, "interrupted") if len(calls) == 1 else outcome

    monkeypatch.setattr(trained, "train", once)
    with pytest.raises(KeyboardInterrupt):
        trained.train_model(work, RENDERING)
    assert not trained.is_trained(work, RENDERING)
    first = trained.train_model(work, RENDERING)
    assert calls == [False, True]
    assert trained.train_model(work, RENDERING) == first
    assert calls == [False, True]
    # What begins with it trains the other half, and its hours are those of both.
    second = trained.train_model(work, SEQUENTIAL)
    assert second.sha256 != first.sha256
    assert first.runs.items() < second.runs.items()
    assert measuring.hours_of([first, second]) == sum(h for h in second.runs.values() if h)
    assert measuring.hours_of([]) is None
