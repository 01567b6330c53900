"""Three scenes, and a library of two others, behind a real server, for tests of the service."""

import http.client
import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

from box_room import OFFICE, box_room, with_cameras
from instok3d.library.entries import Encoder
from instok3d.library.folder import FolderLibrary
from instok3d.service.library_tools import LibraryTools
from instok3d.service.tool import Tools
from instok3d.service.tools import Rooms
from instok3d.service.web import serving
from instok3d.viewer.guard import Guard, random_token
from instok3d.viewer.serving import free_port
from made_encoder import MadeTeacher
from made_entries import made_entries
from made_scene import made_empty_scene
from patience import SECONDS


def office_rooms() -> Rooms:
    eyes = [(2.0, -1.5, 1.8), (3.5, 0.2, 1.6)]
    before = with_cameras(box_room(OFFICE), eyes, (1.6, 2.4, 0.6))
    after = box_room(OFFICE, seed=1).remove("stool")
    return Rooms({"monday": before, "friday": after, "empty": made_empty_scene()})


def office_library(folder: Path) -> LibraryTools:
    """A library whose scenes are gone."""
    library = FolderLibrary.create(folder / "lib")
    for seed, place in enumerate(("/data/north/room.itk", "/data/south/room.itk")):
        library.add(place, made_entries(3, seed, Encoder("made-3", 3), ["chair", "lamp"]))
    return LibraryTools(FolderLibrary(folder / "lib"), MadeTeacher())


@contextmanager
def served(*tools: Tools) -> Iterator[Guard]:
    guard = Guard(random_token(), "127.0.0.1", free_port("127.0.0.1", 0))
    with serving(tools, guard):
        yield guard


def ask(
    guard: Guard, target: str, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, http.client.HTTPMessage, bytes]:
    """The answer to a request with the token, unless another Authorization is given."""
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=SECONDS)
    connection.putrequest(method, target, skip_host="Host" in headers)
    for name, value in ({"Authorization": f"Bearer {guard.token}"} | headers).items():
        if value:
            connection.putheader(name, value)
    if body is not None:
        connection.putheader("Content-Length", str(len(body)))
    connection.endheaders(body)
    response = connection.getresponse()
    found = response.status, response.headers, response.read()
    connection.close()
    return found


def value_of(guard: Guard, target: str) -> Any:
    status, headers, body = ask(guard, target)
    assert (status, headers["Content-Type"]) == (200, "application/json"), body
    return json.loads(body)


def png(width: int = 8, height: int = 8) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (width, height), (200, 20, 20)).save(stream, "PNG")
    return stream.getvalue()
