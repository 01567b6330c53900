"""The stand-in of the hub for each test, and a cache of its own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from hub_server import TOKEN, StandIn, running_hub

constants = pytest.importorskip("huggingface_hub.constants")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """That of huggingface-hub, empty; and uploads by LFS, without the protocol of hf-xet."""
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "no_token"))
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    return tmp_path / "cache"


@pytest.fixture
def hub(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StandIn]:
    """The user ada is logged in."""
    with running_hub() as known:
        monkeypatch.setenv("HF_ENDPOINT", known.url)
        monkeypatch.setenv("HF_TOKEN", TOKEN)
        yield known


@pytest.fixture
def no_network(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that is not there."""
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    monkeypatch.delenv("HF_TOKEN", raising=False)
