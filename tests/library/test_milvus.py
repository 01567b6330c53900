"""A library on a server; Milvus Lite, which runs in this process, stands in for one."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymilvus", reason="pymilvus is not installed")
pytest.importorskip("milvus_lite", reason="milvus-lite is not installed")

from pymilvus import MilvusClient

from instok3d.cli import main
from instok3d.library.entries import Encoder
from instok3d.library.folder import FolderLibrary
from instok3d.library.milvus import BATCH, LIBRARY, MilvusLibrary, open_milvus, scene_id
from made_entries import made_entries
from made_scene import made_scene, made_tokens

PLACE = "milvus://localhost:19530/rooms"


@pytest.fixture
def client(tmp_path: Path) -> Iterator[MilvusClient]:
    found = MilvusClient(str(tmp_path / "server.db"))
    yield found
    found.close()


@pytest.fixture
def library(client: MilvusClient) -> MilvusLibrary:
    return MilvusLibrary(client, "rooms", PLACE)


def test_the_twin_of_a_folder(library: MilvusLibrary, client: MilvusClient, tmp_path: Path):
    folder = FolderLibrary.create(tmp_path / "lib")
    for each in (folder, library):
        for number in range(4):
            each.add(f"/room{number}", made_entries(3 + number, seed=number, labels=["chair"]))
        each.add("/room2", made_entries(2, seed=30))
        each.add("/empty", made_entries(0))
        each.remove(["/room0"])
        each.compact()
    again = MilvusLibrary(client, "rooms", PLACE)
    assert again.encoder == folder.encoder == library.encoder
    assert again.scenes() == folder.scenes()
    assert (again.verify().scenes, again.verify().objects) == (4, 12)
    for seed in range(5):
        query = np.random.default_rng(seed).standard_normal(6)
        found, wanted = again.query(query, 100), folder.query(query, 100)
        assert len(found) == 12
        for one, other in zip(found, wanted, strict=True):
            assert (one.scene, one.object.id) == (other.scene, other.object.id)
            assert (one.object.key, one.object.label) == (other.object.key, other.object.label)
            assert one.object.thumbnail == other.object.thumbnail
            np.testing.assert_array_equal(one.object.box, other.object.box)
            assert one.score == pytest.approx(other.score, abs=2e-3)


def test_a_new_library_answers_nothing(library: MilvusLibrary):
    assert library.encoder is None
    assert library.scenes() == []
    assert library.query(np.ones(6), 5) == []
    assert library.verify().objects == 0
    library.compact()


class Cut:
    """A client whose connection breaks at one of its calls."""

    def __init__(self, client: MilvusClient, calls: int) -> None:
        self._client, self._left = client, calls

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            if name in ("upsert", "delete"):
                self._left -= 1
                if self._left < 0:
                    raise KeyboardInterrupt
            return getattr(self._client, name)(*arguments, **named)

        return call


@pytest.mark.parametrize("calls", range(5))
def test_an_addition_that_was_cut_off_is_not_seen_and_can_be_run_again(
    library: MilvusLibrary, client: MilvusClient, calls: int
):
    library.add("/first", made_entries(3))
    new = made_entries(BATCH + 5, seed=1)  # state, two batches, what was there before, state
    cut = MilvusLibrary(Cut(client, calls), "rooms", PLACE)
    with pytest.raises(KeyboardInterrupt):
        cut.add("/second", new)
    library = MilvusLibrary(client, "rooms", PLACE)
    assert [each.scene for each in library.scenes()] == ["/first"]
    assert {each.scene for each in library.query(np.ones(6), 100)} == {"/first"}
    library.add("/second", new)
    assert [each.objects for each in library.scenes()] == [3, BATCH + 5]
    assert library.verify().objects == BATCH + 8


def test_objects_that_a_scene_no_longer_has_are_gone(library: MilvusLibrary):
    library.add("/room", made_entries(9))
    library.add("/room", made_entries(2, seed=1))
    assert len(library.query(np.ones(6), 100)) == 2


def test_another_encoder_is_refused(library: MilvusLibrary):
    library.add("/room", made_entries())
    with pytest.raises(ValueError, match=r"rooms holds embeddings of the encoder 'made-1'"):
        library.add("/other", made_entries(encoder=Encoder("made-2", 6)))


def test_bad_questions_and_unknown_scenes_are_refused(library: MilvusLibrary):
    library.add("/room", made_entries())
    for query, message in ((np.ones(5), "6 finite"), (np.zeros(6), "query is 0")):
        with pytest.raises(ValueError, match=message):
            library.query(query, 3)
    with pytest.raises(ValueError, match="at most 10000 objects at once, not 10001"):
        library.query(np.ones(6), 10_001)
    with pytest.raises(KeyError, match="has no scene /other"):
        library.remove(["/room", "/other"])
    assert len(library.scenes()) == 1


def test_a_missing_object_is_found_out(library: MilvusLibrary, client: MilvusClient):
    library.add("/room", made_entries())
    client.delete("rooms", ids=[f"{scene_id('/room')}-2"])
    with pytest.raises(ValueError, match=r"/room has 2 of 3 objects; add it again"):
        library.verify()


@pytest.mark.parametrize(
    ("change", "message"),
    [({"version": 2}, "is of version 2, made by a newer instok3d"), ({"format": "x"}, "damaged")],
)
def test_other_libraries_are_refused(
    library: MilvusLibrary, client: MilvusClient, change: dict, message: str
):
    library.add("/room", made_entries())
    row = client.query("rooms_scenes", filter=f'id == "{LIBRARY}"', output_fields=["*"])[0]
    client.upsert("rooms_scenes", [row | {"scene": json.dumps(json.loads(row["scene"]) | change)}])
    with pytest.raises(ValueError, match=message):
        MilvusLibrary(client, "rooms", PLACE)


@pytest.mark.parametrize(
    "place", ["milvus://", "milvus://host", "milvus://host/a-b", "milvus:///x"]
)
def test_what_is_no_place_is_refused(place: str):
    with pytest.raises(ValueError, match="is no place of a library: wanted is milvus://HOST:PORT"):
        open_milvus(place)


def test_a_server_that_does_not_answer_is_named(capsys: pytest.CaptureFixture[str]):
    assert main(["library", "list", "milvus://localhost:1/rooms"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "the server of milvus://localhost:1/rooms does not answer" in error


def test_the_commands_are_the_same(
    client: MilvusClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):  # fmt: skip
    monkeypatch.setattr("pymilvus.MilvusClient", lambda *_, **__: client)
    made_scene(made_tokens()).save(tmp_path / "a.itk")
    assert main(["library", "list", PLACE]) == 2
    assert "there is no library" in capsys.readouterr().err
    assert main(["library", "add", PLACE, str(tmp_path / "a.itk")]) == 0
    assert main(["library", "list", PLACE]) == 0
    assert "2 objects of 1 scenes, encoder made-3" in capsys.readouterr().out
    assert main(["library", "verify", PLACE]) == 0
    assert main(["library", "compact", PLACE]) == 0
    assert main(["library", "remove", PLACE, str(tmp_path / "a.itk")]) == 0
    assert "0 scenes" in capsys.readouterr().out.splitlines()[-1]
