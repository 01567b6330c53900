"""Questions by a picture, of a room and of a library, by the bytes of a file."""

import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from instok3d.cli.query import read_picture
from instok3d.library.adding import add_scene
from instok3d.library.folder import FolderLibrary
from instok3d.scene.query import SceneQueries
from instok3d.semantics.query import shipped
from instok3d.service.library_tools import LibraryTools
from instok3d.service.pictures import MOST_BYTES
from instok3d.service.tools import Rooms
from instok3d.viewer.guard import Guard
from made_encoder import made_room, write_encoder
from served_office import ask, png, served, value_of

pytest.importorskip("mcp", reason="needs mcp: '.[serve]'")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rooms")


@pytest.fixture(scope="module")
def guard(place: Path) -> Iterator[Guard]:
    write_encoder(place / "encoder.safetensors")
    teacher = shipped.load_encoder(place / "encoder.safetensors").teacher
    room = made_room(teacher)
    room.save(place / "room.itk")
    add_scene(str(place / "lib"), place / "room.itk")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shipped, "SHIPPED", place / "encoder.safetensors")
        with served(
            Rooms({"room": room}), LibraryTools(FolderLibrary(place / "lib"), teacher)
        ) as guard:
            yield guard


def picture(kind: str) -> bytes:
    pixels = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind)
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_a_picture_is_answered_as_the_same_file_is(guard: Guard, place: Path, kind: str):
    sent = picture(kind)
    status, _, body = ask(guard, "/api/query_picture?k=2", "POST", sent)
    found = json.loads(body)
    assert status == 200, body
    (place / "asked").write_bytes(sent)
    encoder = shipped.load_encoder(place / "encoder.safetensors")
    room = made_room(encoder.teacher)
    wanted = SceneQueries(room, encoder).picture(read_picture(place / "asked"), 2)
    assert found["understood"] == "one object like the picture"
    shown = found["answers"] or found["closest"]
    assert [each["id"] for each in shown] == [
        each.object.id for each in (wanted.found or wanted.ranked[:3])
    ]
    scores = [each.score for each in (wanted.found or wanted.ranked[:3])]
    assert [each["score"] for each in shown] == pytest.approx(scores, abs=1e-6)

    status, _, body = ask(guard, "/api/library_query_picture?k=1", "POST", sent)
    (match,) = json.loads(body)["matches"]
    assert status == 200
    embedding = encoder.picture(read_picture(place / "asked")).numpy()
    (best,) = FolderLibrary(place / "lib").query(embedding, 1)
    assert (match["scene"], match["id"]) == ("room.itk", best.object.id)
    assert match["score"] == pytest.approx(best.score, abs=1e-6)


def test_words_and_pictures_share_what_is_known_of_a_scene(guard: Guard):
    status, _, body = ask(guard, "/api/query?text=chair")
    found = json.loads(body)
    assert status == 200, body
    assert found["present"]
    assert found["answers"][0]["id"] == 1


@pytest.mark.parametrize("target", ["/api/query_picture?k=2", "/api/library_query_picture"])
@pytest.mark.parametrize(
    ("sent", "status", "words"),
    [
        (b"", 400, "no picture came: send the bytes of a JPEG, PNG or WebP file as body"),
        (b"GIF8", 400, "the body is no picture that can be read: send a sound JPEG, PNG or WebP"),
        (png()[:45], 400, "the body is no picture that can be read"),
        (png(8000, 2001), 400, "of at most 16 megapixels"),
        (b"x" * (MOST_BYTES + 1), 413, f"more than {MOST_BYTES} bytes: send a smaller one"),
    ],
    ids=["none", "text", "cut off", "too many pixels", "too many bytes"],
)
def test_what_is_no_picture_is_refused(
    guard: Guard, target: str, sent: bytes, status: int, words: str
):
    found, headers, body = ask(guard, target, "POST", sent)
    assert headers["Content-Type"] == "application/json"
    assert (found, words in json.loads(body)["error"]) == (status, True), body


def test_the_document_says_that_a_picture_must_come(guard: Guard):
    posted = value_of(guard, "/openapi.json")["paths"]["/api/query_picture"]["post"]
    assert posted["requestBody"]["required"]
    for each in posted["requestBody"]["content"].values():
        assert each["schema"]["minLength"] == 1
    assert "413" in posted["responses"]
