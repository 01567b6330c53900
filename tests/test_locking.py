"""A lock keeps others out for as long as its holder lives, and leaves nothing behind."""

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from instok3d.locking import alone_in, remove_leftovers, workplace


def test_a_second_run_is_refused_and_a_later_one_is_not(tmp_path: Path):
    lock = tmp_path / ".lock"
    with (
        alone_in(lock, "wait"),
        pytest.raises(ValueError, match="wait"),
        alone_in(lock, "wait"),
    ):
        pass
    assert not lock.exists()
    with alone_in(lock, "wait"):
        assert lock.exists()


def test_it_is_given_up_after_an_error_and_after_a_kill(tmp_path: Path):
    lock = tmp_path / ".lock"
    with pytest.raises(KeyboardInterrupt), alone_in(lock, "wait"):
        raise KeyboardInterrupt
    program = (
        "import os, sys, fcntl; stream = open(sys.argv[1], 'w'); "
        "fcntl.flock(stream, fcntl.LOCK_EX); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", program, lock], check=False)
    assert lock.exists()
    with alone_in(lock, "wait"):
        pass


def test_a_lock_on_a_file_that_was_removed_meanwhile_does_not_count(tmp_path: Path, monkeypatch):
    lock = tmp_path / ".lock"
    flock = fcntl.flock

    def late(*arguments) -> None:
        """The holder ends, and a third run begins, between the opening and the locking."""
        lock.unlink()
        lock.touch()
        flock(*arguments)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(ValueError, match="wait"), alone_in(lock, "wait"):
        pass
    monkeypatch.setattr(fcntl, "flock", lambda *_: os.unlink(lock))
    with pytest.raises(ValueError, match="wait"), alone_in(lock, "wait"):
        pass


def test_a_disk_without_locks_is_used_with_a_warning(tmp_path: Path, monkeypatch):
    def without(*_) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", without)
    with pytest.warns(UserWarning, match="has no locks"), alone_in(tmp_path / ".lock", "wait"):
        pass
    assert not (tmp_path / ".lock").exists()


def test_workplaces_of_the_living_stay_and_those_of_the_dead_go(tmp_path: Path):
    target = tmp_path / "a.txt"
    program = (
        "import os, sys; from pathlib import Path; from instok3d.locking import workplace\n"
        "with workplace(Path(sys.argv[1])) as place: (place / 'half').touch(); os._exit(0)"
    )
    with workplace(target) as living:
        subprocess.run([sys.executable, "-c", program, target], check=True)
        assert len(list(tmp_path.iterdir())) == 2
        remove_leftovers(tmp_path)
        assert list(tmp_path.iterdir()) == [living]
        subprocess.run([sys.executable, "-c", program, target], check=True)
    with workplace(target) as place:
        assert [path.name for path in place.iterdir()] == ["lock"]
        assert list(tmp_path.iterdir()) == [place]
    assert not list(tmp_path.iterdir())


def test_what_another_put_in_the_place_is_not_followed(tmp_path: Path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "diary.txt").write_text("mine")
    with workplace(tmp_path / "a.txt") as place:
        name = place.name
    (tmp_path / name).symlink_to(tmp_path / "home")
    with workplace(tmp_path / "a.txt") as place:
        assert place.name != name
    assert (tmp_path / "home" / "diary.txt").read_text() == "mine"


def test_on_a_disk_without_locks_a_workplace_goes_with_its_block(tmp_path: Path, monkeypatch):
    def without(*_) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", without)
    with workplace(tmp_path / "a.txt") as first, workplace(tmp_path / "a.txt") as second:
        assert {path.name for path in tmp_path.iterdir()} == {first.name, second.name}
        remove_leftovers(tmp_path)
        assert first.is_dir()
    assert not list(tmp_path.iterdir())
