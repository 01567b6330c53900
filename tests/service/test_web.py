"""Real requests to a real server of three scenes and a library."""

import io
import json
import random
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlencode

import pytest
from PIL import Image

from instok3d.service.openapi import REFUSALS
from instok3d.service.tools import Rooms
from instok3d.viewer.guard import Guard
from served_office import ask, office_library, office_rooms, png, served, value_of

pytest.importorskip("mcp", reason="needs mcp: '.[serve]'")


@pytest.fixture(scope="module")
def rooms() -> Rooms:
    return office_rooms()


@pytest.fixture(scope="module")
def guard(rooms: Rooms, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guard]:
    with served(rooms, office_library(tmp_path_factory.mktemp("library"))) as guard:
        yield guard


def refusal(guard: Guard, target: str) -> tuple[int, str]:
    status, headers, body = ask(guard, target)
    assert headers["Content-Type"] == "application/json"
    assert headers["Cache-Control"] == "no-store"
    return status, json.loads(body)["error"]


def test_scenes_objects_and_words(guard: Guard):
    scenes = value_of(guard, "/api/list_scenes")["scenes"]
    assert [(each["name"], each["objects"]) for each in scenes] == [
        ("monday", 8), ("friday", 7), ("empty", 0),
    ]  # fmt: skip
    assert "desk#3: yellow; " in value_of(guard, "/api/describe")["text"]
    assert value_of(guard, "/api/describe?scene=empty")["objects"] == []
    listed = value_of(guard, "/api/list_objects?scene=monday")["objects"]
    assert [each["key"] for each in listed][:3] == ["floor#1", "wall#2", "desk#3"]
    assert all("mask" not in seen for each in listed for seen in each["seen"])
    desk = value_of(guard, "/api/get_object?object=desk")
    assert desk["id"] == 3
    assert desk["seen"][0]["mask"]["counts"]
    assert value_of(guard, "/api/get_object?object=desk%233") == desk


def test_pictures_are_png_of_the_size_that_was_asked_for(guard: Guard):
    for query, size in (
        ("view=1&height=32", (32, 32)),
        ("around=true&view=7&height=24&width=40", (40, 24)),
        ("show=objects&height=16&only=desk", (16, 16)),
        ("scene=friday&around=true&height=16", (16, 16)),
    ):
        status, headers, body = ask(guard, f"/api/render?{query}")
        assert (status, headers["Content-Type"]) == (200, "image/png"), body
        assert Image.open(io.BytesIO(body)).size == size


def test_goals_and_differences(guard: Guard):
    goal = value_of(guard, "/api/goal?object=cabinet&radius=0.3")
    assert (goal["object"], goal["units"], goal["radius"]) == ("cabinet#6", "metres", 0.3)
    changes = value_of(guard, "/api/difference?before=monday&after=friday")["changes"]
    assert [each["before"] for each in changes if each["kind"] == "gone"] == ["stool#8"]


@pytest.mark.parametrize(
    ("target", "status", "words"),
    [
        ("/api/get_object?object=zebra", 404, "no object 'zebra' in this scene"),
        ("/api/describe?scene=tuesday", 404, "no scene 'tuesday'; there are: monday, friday"),
        ("/api/describe?scene=../../etc/passwd", 404, "no scene '../../etc/passwd'"),
        ("/api/render?view=2", 404, "no view 2 of this scene; its views are 0 to 1"),
        ("/api/render?scene=friday", 404, "it has none: look from around"),
        ("/api/render?height=5000", 400, "height must be a whole number from 16 up to 1024"),
        ("/api/describe?most=1&most=2", 400, "most was given twice"),
        ("/api/describe?x=1", 400, "no parameter 'x'"),
        ("/api/goal", 400, "object is missing"),
        ("/api/goal?object=%ff", 400, "bytes that are no UTF-8"),
        ("/api/describe?" + "&".join(f"a{i}=1" for i in range(40)), 400, "at most 32 arguments"),
        ("/api/goal?object=desk&radius=1.4", 409, "no free spot for a robot"),
        ("/api/query?text=chair", 409, "this scene has no semantics"),
        ("/api/difference?before=monday&after=empty", 409, "share too few objects"),
        ("/", 404, "there is nothing here; /openapi.json says what is"),
        ("/api/../../etc/passwd", 404, "there is nothing here"),
        ("/api/query_picture", 405, "this address takes another method"),
    ],
)
def test_what_cannot_be_answered_is_one_sentence(
    guard: Guard, target: str, status: int, words: str
):
    found, said = refusal(guard, target)
    assert (found, words in said) == (status, True), said


def test_only_whoever_has_the_token_gets_an_answer(guard: Guard):
    target = "/api/list_scenes"
    assert ask(guard, f"{target}?token={guard.token}", Authorization="")[0] == 200
    cookie = f"{guard.cookie}={guard.token}"
    assert ask(guard, target, Authorization="", Cookie=cookie)[0] == 200
    for path in (target, "/openapi.json", "/mcp"):
        assert ask(guard, path, Authorization="")[0] == 403
        assert ask(guard, path, Authorization=f"Bearer {guard.token}x")[0] == 403
        assert ask(guard, path, Authorization=f"Basic {guard.token}")[0] == 403
        assert ask(guard, path, Host="evil.example")[0] == 403
        assert ask(guard, path, Origin="http://evil.example")[0] == 403
    assert ask(guard, target, Origin=f"http://127.0.0.1:{guard.port}")[0] == 200
    status, headers, _ = ask(guard, target, "POST", b"")
    assert (status, set(headers["Allow"].split(", "))) == (405, {"GET", "HEAD"})
    assert ask(guard, "/api/query_picture", "POST", b"x", Authorization="")[0] == 403


def test_a_hundred_requests_at_once_are_all_answered_alike(guard: Guard):
    targets = ["/api/list_scenes", "/api/describe?most=2&scene=friday", "/api/goal?object=box",
               "/api/render?height=16", "/api/get_object?object=zebra"]  # fmt: skip
    with ThreadPoolExecutor(100) as pool:
        found = list(pool.map(lambda number: ask(guard, targets[number % 5])[::2], range(100)))
    assert len(found) == 100
    for place in range(5):
        assert len(set(found[place::5])) == 1
        assert found[place][0] == (404 if place == 4 else 200)


def drawn(schema: dict, draw: random.Random) -> str:
    """A value by its schema, or one that is near it."""
    if draw.random() < 0.15:
        return draw.choice(["", "\x00", "-1", "1e999", "NaN", "é" * 300, "true", "[]"])
    if "enum" in schema:
        return draw.choice(schema["enum"])
    if schema["type"] == "boolean":
        return draw.choice(["true", "false"])
    if schema["type"] == "string":
        return draw.choice(
            ["monday", "friday", "empty", "desk", "box#7", "1", "chair", "?", "north/room.itk"]
        )
    low, high = schema.get("minimum", 0), min(schema.get("maximum", 9), 40)
    number = draw.uniform(low, high)
    return str(round(number) if schema["type"] == "integer" else number)


def test_drawn_requests_get_answers_that_the_document_knows(guard: Guard):
    document = value_of(guard, "/openapi.json")
    assert document["openapi"] == "3.1.0"
    draw = random.Random(0)
    statuses = set()
    for path, methods in document["paths"].items():
        for _ in range(6 if path.endswith("difference") else 25):
            ((method, operation),) = methods.items()
            given = {each["name"]: drawn(each["schema"], draw)
                     for each in operation["parameters"]
                     if each["required"] or draw.random() < 0.6}  # fmt: skip
            sent = draw.choice([b"", b"\xff\xd8no", png()]) if method == "post" else None
            target = f"{path}?{urlencode(given)}"
            status, headers, body = ask(guard, target, method.upper(), sent)
            answers = operation["responses"]
            assert str(status) in answers, (path, given, body)
            assert status != 500, (path, given, body)
            assert headers["Content-Type"] in answers[str(status)]["content"]
            statuses.add(status)
    assert statuses == {200, 400, 404, 409}
    assert set(REFUSALS) > {"400", "404", "409", "500"}


def test_nothing_is_served_without_a_scene():
    with pytest.raises(ValueError, match="no scene to serve"):
        Rooms({})
