"""Three scenes behind a real server, for tests of the service."""

import http.client
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from box_room import OFFICE, box_room, with_cameras
from instok3d.service.tools import Rooms
from instok3d.service.web import serving
from instok3d.viewer.guard import Guard, random_token
from instok3d.viewer.serving import free_port
from made_scene import made_empty_scene
from patience import SECONDS


def office_rooms() -> Rooms:
    eyes = [(2.0, -1.5, 1.8), (3.5, 0.2, 1.6)]
    before = with_cameras(box_room(OFFICE), eyes, (1.6, 2.4, 0.6))
    after = box_room(OFFICE, seed=1).remove("stool")
    return Rooms({"monday": before, "friday": after, "empty": made_empty_scene()})


@contextmanager
def served(rooms: Rooms) -> Iterator[Guard]:
    guard = Guard(random_token(), "127.0.0.1", free_port("127.0.0.1", 0))
    with serving(rooms, guard):
        yield guard


def ask(
    guard: Guard, target: str, method: str = "GET", **headers: str
) -> tuple[int, http.client.HTTPMessage, bytes]:
    """The answer to a request with the token, unless another Authorization is given."""
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=SECONDS)
    connection.putrequest(method, target, skip_host="Host" in headers)
    for name, value in ({"Authorization": f"Bearer {guard.token}"} | headers).items():
        if value:
            connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    found = response.status, response.headers, response.read()
    connection.close()
    return found


def value_of(guard: Guard, target: str) -> Any:
    status, headers, body = ask(guard, target)
    assert (status, headers["Content-Type"]) == (200, "application/json"), body
    return json.loads(body)
