"""The tools over MCP, asked by the official client over HTTP."""

import asyncio
import base64
import io
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from PIL import Image

from instok3d.service.tools import Rooms
from instok3d.viewer.guard import Guard
from served_office import ask, office_library, office_rooms, served, value_of

mcp = pytest.importorskip("mcp", reason="needs mcp: '.[serve]'")
httpx2 = pytest.importorskip("httpx2", reason="needs mcp: '.[serve]'")


@pytest.fixture(scope="module")
def rooms() -> Rooms:
    return office_rooms()


@pytest.fixture(scope="module")
def guard(rooms: Rooms, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guard]:
    with served(rooms, office_library(tmp_path_factory.mktemp("library"))) as guard:
        yield guard


def asked(guard: Guard, question: Callable[[Any], Awaitable[Any]], token: str = "") -> Any:
    """What a client gets that connects, asks and leaves."""
    from mcp.client.streamable_http import streamable_http_client

    async def run() -> Any:
        headers = {"Authorization": f"Bearer {token or guard.token}"}
        async with httpx2.AsyncClient(headers=headers) as web:
            address = f"http://127.0.0.1:{guard.port}/mcp"
            async with mcp.Client(streamable_http_client(address, http_client=web)) as client:
                return await question(client)

    return asyncio.run(run())


def test_the_tools_are_those_of_the_api(guard: Guard, rooms: Rooms):
    listed = asked(guard, lambda client: client.list_tools()).tools
    paths = value_of(guard, "/openapi.json")["paths"]
    assert [f"/api/{each.name}" for each in listed] == [
        path for path, methods in paths.items() if "get" in methods
    ]
    assert {f"/api/{tool.name}" for tool in rooms.tools()} < set(paths)
    goal = next(each for each in listed if each.name == "goal")
    assert goal.input_schema["required"] == ["object"]
    assert goal.annotations.read_only_hint


def test_answers_are_those_of_the_api(guard: Guard):
    found = asked(guard, lambda client: client.call_tool("describe", {"scene": "friday"}))
    assert not found.is_error
    assert found.structured_content == value_of(guard, "/api/describe?scene=friday")
    assert "chair#5: " in found.content[0].text


def test_a_picture_is_a_picture(guard: Guard):
    found = asked(guard, lambda client: client.call_tool("render", {"height": 24, "view": 1}))
    (picture,) = found.content
    assert picture.mime_type == "image/png"
    assert Image.open(io.BytesIO(base64.b64decode(picture.data))).size == (24, 24)


def test_objects_of_a_library_are_found_and_shown(guard: Guard):
    asking = {"text": "lamp", "k": 1}
    found = asked(guard, lambda client: client.call_tool("library_query", asking))
    (match,) = found.structured_content["matches"]
    assert found.structured_content == value_of(guard, "/api/library_query?text=lamp&k=1")
    which = {"scene": match["scene"], "id": match["id"]}
    shown = asked(guard, lambda client: client.call_tool("library_thumbnail", which)).content[0]
    assert shown.mime_type == "image/jpeg"
    target = f"/api/library_thumbnail?scene={match['scene']}&id={match['id']}"
    assert base64.b64decode(shown.data) == ask(guard, target)[2]


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("goal", {"object": "zebra"}, "no object 'zebra' in this scene"),
        ("describe", {"most": 0}, "most must be a whole number from 1 up to 1000"),
        ("render", {"view": "0", "height": True}, "height must be a whole number"),
        ("query_picture", {}, "no tool 'query_picture'; there are: list_scenes"),
        ("library_entry", {"scene": "x", "id": -1}, "id must be a whole number from 0"),
        ("delete", {}, "no tool 'delete'; there are: list_scenes"),
    ],
)
def test_refusals_are_answers_that_say_why(guard: Guard, name: str, arguments: dict, words: str):
    found = asked(guard, lambda client: client.call_tool(name, arguments))
    assert found.is_error
    assert words in found.content[0].text


def test_a_wrong_token_gets_nothing(guard: Guard):
    with pytest.raises(ExceptionGroup) as caught:
        asked(guard, lambda client: client.list_tools(), token="x" * 32)
    assert caught.value.subgroup(mcp.MCPError) is not None
