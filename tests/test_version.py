"""Version and commit: of a source tree, of an installed package, of neither."""

import subprocess
from pathlib import Path

import pytest

import instok3d
from instok3d import version
from instok3d.cli import main
from instok3d.version import commit_of, current_commit, generator, short

COMMIT = "0123456789abcdef" * 2 + "01234567"


def git(root: Path, *words: str) -> str:
    alone = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    command = ["git", "-C", str(root), *alone, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def committed(root: Path) -> str:
    git(root, "init", "-q")
    git(root, "add", "-A")
    git(root, "commit", "-q", "-m", "all")
    return git(root, "rev-parse", "HEAD")


@pytest.fixture
def source_tree(tmp_path: Path) -> Path:
    """The package of a source tree without git."""
    package = tmp_path / "src" / "instok3d"
    package.mkdir(parents=True)
    (package / "types.py").write_text("a = 1\n")
    (tmp_path / "pyproject.toml").touch()
    return package


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """The package in an environment that lies in a repository of somebody else."""
    package = tmp_path / "venv" / "site-packages" / "instok3d"
    package.mkdir(parents=True)
    (tmp_path / "src").mkdir()
    (tmp_path / "pyproject.toml").touch()
    committed(tmp_path)
    return package


def test_a_source_tree_says_where_git_stands(source_tree: Path):
    head = committed(source_tree.parents[1])
    assert commit_of(source_tree) == head


def test_a_changed_source_tree_has_a_plus(source_tree: Path):
    head = committed(source_tree.parents[1])
    (source_tree / "types.py").write_text("a = 2\n")
    assert commit_of(source_tree) == f"{head}+"


def test_a_source_tree_of_git_does_not_believe_a_left_over_file(source_tree: Path):
    head = committed(source_tree.parents[1])
    (source_tree.parents[1] / "COMMIT").write_text(COMMIT)
    assert commit_of(source_tree) == head


def test_an_unpacked_source_distribution_says_what_it_was_made_from(source_tree: Path):
    (source_tree.parents[1] / "COMMIT").write_text(f"{COMMIT}+\n")
    assert commit_of(source_tree) == f"{COMMIT}+"


def test_an_installed_package_says_what_it_was_built_from(installed: Path):
    (installed / "COMMIT").write_text(f"{COMMIT}\n")
    assert commit_of(installed) == COMMIT


def test_an_installed_package_is_not_of_the_repository_around_it(installed: Path):
    assert commit_of(installed) is None


@pytest.mark.parametrize("damaged", [b"", b"\n", b"main", COMMIT[:9].encode(), b"\xff" * 40])
def test_what_is_no_commit_counts_as_none(installed: Path, damaged: bytes):
    (installed / "COMMIT").write_bytes(damaged)
    assert commit_of(installed) is None


def test_without_a_commit_the_version_stands_in(installed: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(version, "PACKAGE", installed)
    current_commit.cache_clear()
    try:
        assert current_commit() == f"{instok3d.__version__} (no commit known)"
        assert short(current_commit()) == current_commit()
        assert generator() == f"instok3d {instok3d.__version__} (no commit known)"
    finally:
        current_commit.cache_clear()


def test_what_is_written_names_program_version_and_commit(
    installed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (installed / "COMMIT").write_text(f"{COMMIT}+\n")
    monkeypatch.setattr(version, "PACKAGE", installed)
    expected = f"instok3d {instok3d.__version__} (commit 012345678+)"
    assert generator() == expected
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"{expected}\n"


@pytest.mark.parametrize(
    ("commit", "digits"), [(COMMIT, "012345678"), (f"{COMMIT}+", "012345678+"), ("text", "text")]
)
def test_nine_digits_and_the_sign_of_changes_stand_for_a_commit(commit: str, digits: str):
    assert short(commit) == digits
