import json
from pathlib import Path

import pytest

from instok3d.cli import main
from scannet_files import write_scan


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    write_scan(tmp_path / "scannet", "scene0000_00", 11)
    write_scan(tmp_path / "scannet", "scene0001_00", 11)
    return tmp_path / "scannet"


def command(scans: Path, *options: str) -> list[str]:
    out = str(scans.parent / "out")
    return ["data", "prepare", "scannet", str(scans), "-o", out, "--size", "24", "--workers", "1",
            "--min-frames", "1",
            *options]  # fmt: skip


def test_prepare_says_what_it_takes_and_what_it_made(
    scans: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(command(scans, "--dry-run")) == 0
    before = capsys.readouterr()
    assert "2 scenes to prepare, 0 already there; about 0.00 GB" in before.err
    assert before.out == ""
    assert not (scans.parent / "out").exists()
    assert main(command(scans)) == 0
    assert "2 new scenes of 4 frames" in capsys.readouterr().out
    assert main(command(scans)) == 0
    assert "0 new scenes of 0 frames, 0.00 GB; 2 were already there" in capsys.readouterr().out


def test_failed_scenes_give_exit_code_2_and_their_reason(
    scans: Path, capsys: pytest.CaptureFixture[str]
):
    sens = scans / "scene0001_00" / "scene0001_00.sens"
    sens.write_bytes(sens.read_bytes()[:2000])
    assert main(command(scans)) == 2
    shown = capsys.readouterr()
    assert "1 new scenes of 2 frames" in shown.out
    assert "failed scene0001_00:" in shown.out
    assert "is cut off: it ends at byte 2000" in shown.out
    assert "is cut off: it ends at byte 2000" in shown.err


def test_verify_lists_each_fault(scans: Path, capsys: pytest.CaptureFixture[str]):
    out = scans.parent / "out"
    main(command(scans))
    assert main(["data", "verify", str(out)]) == 0
    (out / "scene0000_00" / "depths" / "000001.png").write_bytes(b"x")
    (out / "scene0001_00" / "labels" / "000000.png").unlink()
    capsys.readouterr()
    assert main(["data", "verify", str(out)]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("scene0000_00/depths/000001.png: has 1 bytes, should have")
    assert lines[1] == "scene0001_00/labels/000000.png: is missing"
    assert lines[2].endswith("2 scenes, 2 faults")
    assert main(["data", "verify", str(out), "--json"]) == 2
    shown = json.loads(capsys.readouterr().out)
    assert shown["scenes"] == 2
    assert [fault["path"] for fault in shown["faults"]] == [
        "scene0000_00/depths/000001.png",
        "scene0001_00/labels/000000.png",
    ]


def test_a_lost_index_can_be_written_anew(scans: Path, capsys: pytest.CaptureFixture[str]):
    out = scans.parent / "out"
    main(command(scans))
    (out / "scenes.json").unlink()
    assert main(["data", "verify", str(out)]) == 2
    assert main(["data", "verify", str(out), "--index"]) == 0
    assert (out / "scenes.json").is_file()
    assert main(["data", "verify", str(out / "none")]) == 2
    assert "there is no folder" in capsys.readouterr().err


def test_a_folder_without_scans_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["data", "prepare", "scannet", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("instok3d: ")
    assert error.count("\n") == 1
    assert "holds no ScanNet scans" in error
