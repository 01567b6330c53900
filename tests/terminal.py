"""A stderr that says it is a terminal and keeps what is drawn on it."""

import io
import sys

import pytest


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    @property
    def drawn(self) -> list[str]:
        """What stood on the last line, one after the other, without the characters that clear."""
        parts = self.getvalue().replace("\r\033[K", "\n").replace("\r", "\n").split("\n")
        return [part.strip() for part in parts if part.strip()]


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """The new stderr; call it in the test itself, since pytest sets its own after the fixtures."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    return stream
