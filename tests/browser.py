"""A headless Chromium for tests of pages; they skip where there is none."""

import atexit
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import pytest

# WebGL in software: the tests must not depend on a graphics card.
ARGUMENTS = [
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-quic",
]  # fmt: skip
PATIENCE_MS = 300_000
"""A frame takes seconds where other tests run beside it."""


def chromium_path() -> str | None:
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


@cache
def browser() -> Any:
    """One for all tests of a process: Playwright starts no second one beside it."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: '.[dev]'")
    path = chromium_path()
    if path is None:
        pytest.skip("needs Chromium (Debian: apt-get install chromium)")
    started = playwright.sync_playwright().start()
    atexit.register(started.stop)
    opened = started.chromium.launch(executable_path=path, args=ARGUMENTS)
    atexit.register(opened.close)
    return opened


@contextmanager
def open_page(address: str, ready: str, *, width: int = 360, height: int = 240) -> Iterator[Any]:
    """The page once `ready` holds in it; `page.asked` lists the addresses that it asked for."""
    page = browser().new_page(viewport={"width": width, "height": height})
    try:
        page.set_default_timeout(PATIENCE_MS)
        page.asked, page.errors = [], []
        page.on("request", lambda request: page.asked.append(request.url))
        page.on("pageerror", lambda error: page.errors.append(str(error)))
        page.goto(address)
        page.wait_for_function(ready, polling=100)
        yield page
    finally:
        page.close()
