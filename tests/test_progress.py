import os
import threading

import pytest

from instok3d import progress
from instok3d.progress import StatusLine, format_duration, progress_bar
from terminal import on_terminal


def test_a_bar_shows_count_and_time_on_a_terminal(monkeypatch: pytest.MonkeyPatch):
    terminal = on_terminal(monkeypatch)
    with progress_bar(8, unit="room", done=3) as bar:
        bar.update(2)
    assert "5/8" in terminal.drawn[-1]
    assert "room/s" in terminal.drawn[-1]


def test_without_a_terminal_and_where_it_is_not_wanted_nothing_is_drawn(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    with progress_bar(2, unit="room") as bar:
        bar.update(2)
    line = StatusLine()
    with line.running():
        line.show("geometry")
    assert capsys.readouterr().err == ""
    stream = on_terminal(monkeypatch)
    with progress_bar(2, unit="room", shown=False) as bar:
        bar.update(2)
    assert stream.getvalue() == ""


@pytest.mark.parametrize(("kind", "wanted"), [("bar", "0/2"), ("line", "tokens ...  0m00s")])
def test_the_clock_goes_on_while_nothing_happens(
    kind: str, wanted: str, monkeypatch: pytest.MonkeyPatch
):
    terminal = on_terminal(monkeypatch)
    monkeypatch.setattr(progress, "REDRAWN_S", 0.001)
    redrawn = threading.Event()
    write = terminal.write

    def watched(text: str) -> int:
        if wanted in text and threading.current_thread() is not threading.main_thread():
            redrawn.set()
        return write(text)

    monkeypatch.setattr(terminal, "write", watched)
    line = StatusLine()
    with progress_bar(2, unit="room") if kind == "bar" else line.running():
        line.show("tokens ..." if kind == "line" else "")
        assert redrawn.wait(60)


def test_lines_go_above_the_status_and_at_the_end_it_is_gone(monkeypatch: pytest.MonkeyPatch):
    terminal = on_terminal(monkeypatch)
    line = StatusLine()
    with line.running():
        line.show("step 2/9")
        line.print_above("step 1/9  loss 0.5")
    assert terminal.drawn == ["step 2/9", "step 1/9  loss 0.5", "step 2/9"]
    assert terminal.getvalue().endswith("\r\033[K")


def test_a_line_is_never_longer_than_the_terminal(
    monkeypatch: pytest.MonkeyPatch,
):
    terminal = on_terminal(monkeypatch)
    size = os.terminal_size((20, 10))
    monkeypatch.setattr(progress.shutil, "get_terminal_size", lambda **_: size)
    StatusLine().show("previews: object 17 of 120 ...")
    assert terminal.drawn == ["previews: object 17"]


def test_after_an_error_nothing_is_drawn_any_more(monkeypatch: pytest.MonkeyPatch):
    terminal = on_terminal(monkeypatch)
    line = StatusLine()

    def fail() -> None:
        with line.running():
            line.show("photos ...")
            raise ValueError("no photo")

    with pytest.raises(ValueError, match="no photo"):
        fail()
    assert terminal.getvalue().endswith("\r\033[K")
    assert not any(thread.name == progress.THREAD for thread in threading.enumerate())


def test_durations_read_well():
    assert format_duration(59.9) == "0m59s"
    assert format_duration(7261.0) == "2h01m"
