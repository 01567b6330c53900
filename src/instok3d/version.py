"""Which code this is: its version, and the commit that it stands at or was built from."""

import re
import subprocess
from functools import cache
from pathlib import Path

from instok3d import __version__

PACKAGE = Path(__file__).resolve().parent


@cache
def current_commit() -> str:
    """The commit of the running code: 40 digits, "+" if files were changed since.

    Where none is known (code that came neither by git nor from a build in a git tree), the
    version with "(no commit known)".
    """
    return commit_of(PACKAGE) or f"{__version__} (no commit known)"


def generator() -> str:
    """Program, version and commit, for what this code writes."""
    commit = commit_of(PACKAGE)
    return f"instok3d {__version__} ({f'commit {short(commit)}' if commit else 'no commit known'})"


def short(commit: str) -> str:
    """Nine digits of a commit, and the sign that files were changed since; other text as it is."""
    return f"{commit[:9]}{commit[40:]}" if _is_commit(commit) else commit


@cache
def commit_of(package: Path) -> str | None:
    """The commit of a copy of the package; None where none is known.

    A source tree is asked through git. Any other copy holds what it was built from in its file
    COMMIT, which the build writes (CMakeLists.txt); git would answer there for the repository
    that the environment happens to lie in.
    """
    root = package.parent.parent
    in_source_tree = package.parent.name == "src" and (root / "pyproject.toml").is_file()
    if in_source_tree and (root / ".git").exists():
        return _asked_from_git(root)
    try:
        commit = ((root if in_source_tree else package) / "COMMIT").read_text("ascii").strip()
    except (OSError, UnicodeDecodeError):
        return None
    return commit if _is_commit(commit) else None


def _asked_from_git(root: Path) -> str | None:
    # Without locks: another git command in this tree must not fail because of a question.
    command = ["git", "--no-optional-locks", "describe",
               "--always", "--abbrev=40", "--dirty=+", "--exclude=*"]  # fmt: skip
    try:
        answer = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()


def _is_commit(text: str) -> bool:
    return re.fullmatch(r"[0-9a-f]{40}\+?", text) is not None
