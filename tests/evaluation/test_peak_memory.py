from pathlib import Path

import pytest
import torch

from instok3d.evaluation import peak_memory as module
from instok3d.evaluation.figures import summarize
from instok3d.evaluation.methods import Cost
from instok3d.evaluation.peak_memory import peak_memory
from instok3d.evaluation.scores import SceneScore
from instok3d.model.available_memory import resident_bytes

CPU = torch.device("cpu")
MB = 1_000_000


def peak_of(megabytes: int) -> int:
    with peak_memory(CPU) as peak:
        torch.ones(megabytes * MB // 4)
    if peak.bytes is None:
        pytest.skip("this system does not count peaks anew")
    return peak.bytes


def test_a_block_has_a_peak_of_its_own_and_what_it_holds_is_in_it():
    large, small, nothing = peak_of(400), peak_of(100), peak_of(0)
    assert 350 * MB < large - nothing < 450 * MB
    assert 50 * MB < small - nothing < 150 * MB  # not that of the larger one before it
    assert nothing >= 0.9 * resident_bytes()


@pytest.mark.parametrize(
    ("clear_refs", "status"), [("absent", "VmHWM: 3 kB"), ("here", "VmRSS: 3 kB")]
)
def test_where_the_system_does_not_say_nothing_is_said(
    clear_refs: str, status: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "here").touch()
    (tmp_path / "status").write_text(status)
    place = tmp_path / "here" if clear_refs == "here" else tmp_path / "absent" / "clear_refs"
    monkeypatch.setattr(module, "CLEAR_REFS", place)
    monkeypatch.setattr(module, "STATUS", tmp_path / "status")
    with peak_memory(CPU) as peak:
        pass
    assert peak.bytes is None


def test_kilobytes_of_the_system_are_1024_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "status").write_text("Name: x\nVmHWM:\t      3 kB\n")
    monkeypatch.setattr(module, "CLEAR_REFS", tmp_path / "clear_refs")
    monkeypatch.setattr(module, "STATUS", tmp_path / "status")
    with peak_memory(CPU) as peak:
        pass
    assert peak.bytes == 3072
    assert (tmp_path / "clear_refs").read_text() == "5"


def test_the_largest_peak_of_all_samples_is_stated():
    def scene(*peaks: int | None) -> SceneScore:
        costs = tuple(Cost(1, 0, 0, 0.0, peak_bytes=peak) for peak in peaks)
        return SceneScore("a", None, (), costs=costs)

    assert summarize([scene(5 * MB, 7_500_000), scene(6 * MB, None)]).peak_mb == 7.5
    assert summarize([scene(None), scene()]).peak_mb is None


def test_an_error_in_the_block_stays_what_it_is():
    with pytest.raises(ValueError, match="own"), peak_memory(CPU):
        raise ValueError("own")
