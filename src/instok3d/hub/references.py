"""Names of repositories on the hub: hub:USER/NAME, and hub:USER/NAME@REVISION."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

PREFIX = "hub:"
COMMIT = re.compile("[0-9a-f]{40}")
WORD = "[A-Za-z0-9][A-Za-z0-9._-]*"
NAME = re.compile(f"{PREFIX}({WORD}/{WORD})(?:@([A-Za-z0-9][A-Za-z0-9._/-]*))?")


@dataclass(frozen=True)
class HubReference:
    """A repository on the hub, at one of its revisions."""

    repository: str
    """USER/NAME."""
    revision: str | None = None
    """A branch, a tag or a commit; None = what the main branch has today."""

    @property
    def pinned(self) -> bool:
        """Whether it names a commit: the same files for everybody, at any time."""
        return self.revision is not None and COMMIT.fullmatch(self.revision) is not None

    def at(self, commit: str) -> "HubReference":
        """The same repository at a commit."""
        return replace(self, revision=commit)

    def __str__(self) -> str:
        return PREFIX + self.repository + (f"@{self.revision}" if self.revision else "")


def is_hub(name: object) -> bool:
    """Whether a text or a path names a repository of the hub."""
    return isinstance(name, str | Path) and _text(name).startswith(PREFIX)


def parse_reference(name: str | Path) -> HubReference:
    """The repository that a name stands for.

    Raises:
        ValueError: It is no such name.
    """
    found = NAME.fullmatch(_text(name))
    if found is None:
        raise ValueError(
            f"{_text(name)!r} names no repository of the hub; wanted hub:USER/NAME, or "
            "hub:USER/NAME@REVISION with a branch, a tag or a commit"
        )
    return HubReference(found[1], found[2])


def _text(name: str | Path) -> str:
    return name.as_posix() if isinstance(name, Path) else name
