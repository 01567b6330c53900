"""A library in a folder: what it holds, whoever writes, reads or dies meanwhile."""

import json
import os
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest

from instok3d.library.entries import Encoder, SceneEntries
from instok3d.library.folder import JOINED, SHARDS, FolderLibrary
from instok3d.library.manifest import read_manifest
from kill_points import every_kill
from made_entries import ENCODER, made_entries
from mutations import of_bytes, of_json, survive


def filled(folder: Path, scenes: int = 3) -> FolderLibrary:
    library = FolderLibrary.create(folder)
    for number in range(scenes):
        library.add(f"/room{number}", made_entries(2 + number, seed=number))
    return library


def held(folder: Path) -> dict[str, int]:
    return {each.scene: each.objects for each in FolderLibrary(folder).scenes()}


def test_a_new_library_is_empty_and_answers_nothing(tmp_path: Path):
    library = FolderLibrary.create(tmp_path / "lib")
    assert library.encoder is None
    assert library.scenes() == []
    assert library.query(np.ones(6), 5) == []
    audit = library.verify()
    assert (audit.scenes, audit.objects, audit.bytes) == (0, 0, 0)
    library.compact()


def test_objects_come_back_as_they_were_added(tmp_path: Path):
    entries = made_entries(4, seed=5, labels=["chair", "Tür, links"])
    FolderLibrary.create(tmp_path / "lib").add("/room", entries)
    library = FolderLibrary(tmp_path / "lib")
    for row, wanted in enumerate(entries.objects):
        match = library.query(entries.embeddings[row], 1)[0]
        assert match.scene == "/room"
        assert (match.object.id, match.object.key) == (wanted.id, wanted.key)
        assert (match.object.label, match.object.thumbnail) == (wanted.label, wanted.thumbnail)
        np.testing.assert_array_equal(match.object.box, wanted.box)
        assert match.score == pytest.approx(1, abs=1e-3)


def test_the_nearest_objects_are_those_of_all_scenes_together(tmp_path: Path):
    library = filled(tmp_path / "lib", 5)
    every = np.concatenate([made_entries(2 + n, seed=n).embeddings for n in range(5)])
    every = (every / np.linalg.norm(every, axis=1, keepdims=True)).astype(np.float16)
    query = np.random.default_rng(9).standard_normal(6)
    scores = every.astype(np.float64) @ (query / np.linalg.norm(query))
    names = [(f"/room{n}", i + 1) for n in range(5) for i in range(2 + n)]
    order = np.argsort(-scores)[:7]
    found = library.query(query, 7)
    assert [(each.scene, each.object.id) for each in found] == [names[i] for i in order]
    np.testing.assert_allclose([each.score for each in found], scores[order], atol=1e-5)


def test_more_objects_than_there_are_can_be_asked_for(tmp_path: Path):
    assert len(filled(tmp_path / "lib", 2).query(np.ones(6), 100)) == 5
    assert filled(tmp_path / "lib", 2).query(np.ones(6), 0) == []


def test_a_scene_added_again_takes_the_place_of_the_old_one(tmp_path: Path):
    library = filled(tmp_path / "lib")
    library.add("/room1", made_entries(7, seed=40))
    assert held(tmp_path / "lib") == {"/room0": 2, "/room1": 7, "/room2": 4}
    assert len(library.query(np.ones(6), 100)) == 13


def test_what_was_removed_is_found_no_more(tmp_path: Path):
    library = filled(tmp_path / "lib")
    library.remove(["/room1", "/room0"])
    assert held(tmp_path / "lib") == {"/room2": 4}
    assert {each.scene for each in library.query(np.ones(6), 100)} == {"/room2"}
    with pytest.raises(KeyError, match=r"has no scene /room1: see `library list`"):
        library.remove(["/room2", "/room1"])
    assert held(tmp_path / "lib") == {"/room2": 4}


def test_a_scene_without_objects_is_kept(tmp_path: Path):
    library = FolderLibrary.create(tmp_path / "lib")
    library.add("/empty", made_entries(0))
    assert held(tmp_path / "lib") == {"/empty": 0}
    assert library.query(np.ones(6), 3) == []
    library.compact()
    assert library.verify().scenes == 1


def test_compaction_gives_back_the_room_and_changes_no_answer(tmp_path: Path):
    library = filled(tmp_path / "lib", 20)
    library.remove([f"/room{number}" for number in range(0, 20, 2)])
    query = np.random.default_rng(1).standard_normal(6)
    before, size = library.query(query, 50), library.verify().bytes
    library.compact()
    after = FolderLibrary(tmp_path / "lib").query(query, 50)
    assert [(each.scene, each.object.key, each.score) for each in after] == [
        (each.scene, each.object.key, each.score) for each in before
    ]
    assert library.verify().bytes < 0.7 * size
    assert len(list((tmp_path / "lib" / SHARDS).iterdir())) == 1
    assert not read_manifest(tmp_path / "lib").removed


def test_small_shards_are_joined_so_that_few_are_open(tmp_path: Path):
    library = filled(tmp_path / "lib", 0)
    for number in range(70):
        library.add(f"/room{number}", made_entries(3, seed=number))
        assert len(list((tmp_path / "lib" / SHARDS).iterdir())) <= 3 * JOINED
    assert len(library.scenes()) == 70
    assert library.verify().objects == 210


def test_everything_removed_leaves_a_library_that_can_be_filled_again(tmp_path: Path):
    library = filled(tmp_path / "lib")
    library.remove([each.scene for each in library.scenes()])
    library.compact()
    assert library.verify().bytes == 0
    library.add("/new", made_entries(1))
    assert held(tmp_path / "lib") == {"/new": 1}


def test_a_reader_keeps_what_it_opened_while_a_writer_joins_shards(tmp_path: Path):
    writer = filled(tmp_path / "lib", 5)
    reader = FolderLibrary(tmp_path / "lib")
    before = [each.object.key for each in reader.query(np.ones(6), 100)]
    writer.remove(["/room0"])
    writer.compact()
    assert [each.object.key for each in reader.query(np.ones(6), 100)] == before
    assert len(FolderLibrary(tmp_path / "lib").scenes()) == 4


def test_readers_beside_a_writer_see_whole_scenes_alone(tmp_path: Path):
    folder, seen, done = tmp_path / "lib", [], threading.Event()
    writer = filled(folder, 1)

    def read() -> None:
        while not done.is_set():
            library = FolderLibrary(folder)
            seen.append(len(library.query(np.ones(6), 10_000)))

    readers = [threading.Thread(target=read) for _ in range(3)]
    for each in readers:
        each.start()
    for number in range(40):
        writer.add(f"/more{number}", made_entries(5, seed=number))
    done.set()
    for each in readers:
        each.join()
    assert all((count - 2) % 5 == 0 for count in seen)
    assert seen


def test_a_second_writer_is_told_to_wait(tmp_path: Path):
    library = filled(tmp_path / "lib")
    with library._writing(), pytest.raises(ValueError, match="another command is writing to"):
        FolderLibrary(tmp_path / "lib").add("/x", made_entries())


def test_two_writers_in_turn_lose_nothing(tmp_path: Path):
    first = FolderLibrary.create(tmp_path / "lib")
    second = FolderLibrary(tmp_path / "lib")
    for number in range(12):
        (first, second)[number % 2].add(f"/room{number}", made_entries(2, seed=number))
    assert len(held(tmp_path / "lib")) == 12


def work(folder: Path) -> None:
    """An addition that joins shards, one in place of another, a removal, a compaction."""
    library = FolderLibrary.create(folder / "lib")
    library.add("/new", made_entries(1, seed=50))
    library.add("/room3", made_entries(9, seed=99))
    library.remove(["/room5", "/room6"])
    library.compact()


def states() -> list[dict[str, int]]:
    """What the library may hold after each step of `work`, in order."""
    first = {f"/room{number}": 2 for number in range(JOINED - 1)}
    second = first | {"/new": 1}
    third = second | {"/room3": 9}
    return [first, second, third, {n: each for n, each in third.items() if n[-1] not in "56"}]


def test_killed_anywhere_it_opens_and_misses_at_most_the_scene_in_flight(tmp_path: Path):
    library = FolderLibrary.create(tmp_path / "lib")
    for number in range(JOINED - 1):
        library.add(f"/room{number}", made_entries(2, seed=number))

    def anew() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        shutil.copytree(tmp_path / "lib", tmp_path / "work" / "lib")
        return tmp_path / "work"

    allowed, kills, reached = states(), 0, 0
    for folder in every_kill(anew, work):
        kills += 1
        found = held(folder / "lib")
        assert found in allowed[reached:], f"in state {kills}"
        reached = allowed.index(found)
        if kills % 2 == 0:  # the next writer takes it from there
            FolderLibrary(folder / "lib").verify()
            library = FolderLibrary.create(folder / "lib")
            library.add("/after", made_entries(2))
            assert held(folder / "lib") == found | {"/after": 2}
            named = {each.file for each in read_manifest(folder / "lib").shards}
            assert {each.name for each in (folder / "lib" / SHARDS).iterdir()} == named
            assert not [each for each in (folder / "lib").iterdir() if each.name.startswith(".")]
    assert kills > 80, kills
    assert reached == len(allowed) - 1


def test_killed_while_it_is_made_it_can_be_made(tmp_path: Path):
    def anew() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        (tmp_path / "work").mkdir()
        return tmp_path / "work"

    for folder in every_kill(anew, lambda folder: FolderLibrary.create(folder / "lib")):
        library = FolderLibrary.create(folder / "lib")
        library.add("/room", made_entries(2))
        assert held(folder / "lib") == {"/room": 2}


def test_of_two_that_make_it_neither_loses_what_the_other_added(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # The second one looked before the first one wrote.
    filled(tmp_path / "lib")
    exists = Path.exists
    monkeypatch.setattr(Path, "exists", lambda path: path.name != "library.json" and exists(path))
    FolderLibrary.create(tmp_path / "lib")
    monkeypatch.undo()
    assert len(held(tmp_path / "lib")) == 3


@pytest.mark.parametrize("other", [Encoder("made-2", 6), Encoder("made-1", 7)])
def test_another_encoder_is_refused(tmp_path: Path, other: Encoder):
    library = filled(tmp_path / "lib")
    with pytest.raises(
        ValueError, match=r"holds embeddings of the encoder 'made-1' \(6 channels\)"
    ):
        library.add("/x", made_entries(encoder=other))
    assert len(held(tmp_path / "lib")) == 3


@pytest.mark.parametrize(
    ("query", "message"),
    [(np.ones(5), "must be 6 finite"), (np.full(6, np.nan), "finite"), (np.zeros(6), "query is 0")],
)
def test_queries_that_are_none_are_refused(tmp_path: Path, query: np.ndarray, message: str):
    with pytest.raises(ValueError, match=message):
        filled(tmp_path / "lib").query(query, 3)


def test_embeddings_that_are_none_are_refused():
    good = made_entries()
    for wrong in (good.embeddings[:2], 0 * good.embeddings, np.nan * good.embeddings):
        with pytest.raises(ValueError, match="embeddings"):
            SceneEntries(ENCODER, good.objects, wrong)


def test_a_library_of_a_newer_version_is_refused(tmp_path: Path):
    filled(tmp_path / "lib")
    path = tmp_path / "lib" / "library.json"
    path.write_text(path.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(ValueError, match=r"library\.json is of version 2.*reads version 1: update"):
        FolderLibrary(tmp_path / "lib")


def test_no_library_is_named(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"there is no library .*`instok3d library add`"):
        FolderLibrary(tmp_path)
    (tmp_path / "other.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="is there and is no library"):
        FolderLibrary.create(tmp_path)
    assert os.listdir(tmp_path) == ["other.txt"]


def test_a_shard_that_is_gone_or_changed_is_named(tmp_path: Path):
    library = filled(tmp_path / "lib")
    shard = sorted((tmp_path / "lib" / SHARDS).iterdir())[1]
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(ValueError, match=r"00000002\.safetensors is damaged: its SHA-256 is"):
        FolderLibrary(tmp_path / "lib").verify()
    shard.unlink()
    with pytest.raises(ValueError, match=r"is damaged: shards/00000002\.safetensors is gone"):
        FolderLibrary(tmp_path / "lib")
    assert len(library.scenes()) == 3


def ask(folder: Path) -> object:
    library = FolderLibrary(folder)
    return library.query(np.ones(6), 50) if library.encoder == ENCODER else None


def test_any_damage_of_a_shard_is_refused_or_read(tmp_path: Path):
    folder = tmp_path / "lib"
    filled(folder, 1)
    shard = next((folder / SHARDS).iterdir())
    survive(shard, lambda: ask(folder), of_bytes, 150)


def test_any_damage_of_the_manifest_is_refused_or_read(tmp_path: Path):
    folder = tmp_path / "lib"
    filled(folder, 1)
    path = folder / "library.json"
    survive(path, lambda: ask(folder), of_json, 150)


@pytest.mark.parametrize(
    "change", [{"shards": [{"file": "../../x.safetensors", "rows": 0, "sha256": ""}]},
               {"removed": "all"}, {"encoder": {"name": "x"}}, {"format": "other"}]
)  # fmt: skip
def test_a_manifest_of_other_things_is_refused(tmp_path: Path, change: dict):
    filled(tmp_path / "lib")
    path = tmp_path / "lib" / "library.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ValueError, match=r"library\.json is damaged"):
        FolderLibrary(tmp_path / "lib")


def test_one_object_is_found_by_scene_and_id_whatever_shard_it_is_in(tmp_path: Path):
    library = FolderLibrary.create(tmp_path / "lib")
    for number in range(10):  # the first eight are joined
        library.add(f"room{number}", made_entries(3, seed=number))
    library.add("room3", made_entries(2, seed=40))
    for name, seed, count in (("room0", 0, 3), ("room9", 9, 3), ("room3", 40, 2)):
        for wanted in made_entries(count, seed=seed).objects:
            assert library.entry(name, wanted.id).thumbnail == wanted.thumbnail
    with pytest.raises(KeyError, match="'room3' has no object 3 in the library"):
        library.entry("room3", 3)
    with pytest.raises(KeyError, match="'room77' is not in the library"):
        library.entry("room77", 1)
