"""Real requests to a real server."""

import http.client
import socket
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from instok3d.viewer.guard import Guard
from instok3d.viewer.serving import free_port, serve, stop_serving

pytest.importorskip("viser", reason="needs viser: '.[view]'")


@pytest.fixture(scope="module")
def guard() -> Iterator[Guard]:
    server, guard = serve(port=0, title="test", hover=lambda x, y: f"{x} {y} é")
    yield guard
    stop_serving(server)


@dataclass(frozen=True)
class Answer:
    status: int
    headers: http.client.HTTPMessage
    body: bytes


def ask(guard: Guard, path: str = "/", **headers: str) -> Answer:
    """The answer to a request; its Host is right unless another is given."""
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=60)
    connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
    for name, value in ({"Host": f"127.0.0.1:{guard.port}"} | headers).items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    response = connection.getresponse()
    body = b"" if response.status == 101 else response.read()
    connection.close()
    return Answer(response.status, response.headers, body)


def cookie(guard: Guard) -> dict[str, str]:
    return {"Cookie": f"{guard.cookie}={guard.token}"}


def websocket(guard: Guard, **headers: str) -> dict[str, str]:
    return {
        "Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13",
        "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Origin": f"http://127.0.0.1:{guard.port}", **headers,
    }  # fmt: skip


def test_the_address_hands_the_token_over_to_a_cookie(guard: Guard):
    answer = ask(guard, f"/?token={guard.token}")
    assert (answer.status, answer.headers.get("Location")) == (303, "/")
    given = answer.headers.get("Set-Cookie") or ""
    assert given.split(";")[0] == f"{guard.cookie}={guard.token}"
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= {each.strip() for each in given.split(";")}
    page = ask(guard, Cookie=given.split(";")[0])
    zipped = ask(guard, Cookie=given.split(";")[0], Accept_Encoding="gzip, br")
    assert page.status == zipped.status == 200
    assert page.body == zipped.body
    assert b"instok3d-hover" in page.body
    assert b"<html" in page.body


def test_what_is_under_the_pointer_is_told_to_our_page_alone(guard: Guard):
    answer = ask(guard, "/hover?x=0.25&y=1", **cookie(guard))
    assert (answer.status, answer.body.decode()) == (200, "0.25 1.0 é")
    assert ask(guard, "/hover?x=0.25&y=1").status == 403
    for query in ("", "x=0.5", "x=a&y=0", "x=nan&y=0", "x=2&y=0", "x=-1&y=0", "x=1&x=1&y=0"):
        assert ask(guard, f"/hover?{query}", **cookie(guard)).status == 400


def test_the_page_may_neither_send_nor_be_framed_nor_be_kept(guard: Guard):
    page = ask(guard, **cookie(guard))
    policy = page.headers.get("Content-Security-Policy") or ""
    own = f"127.0.0.1:{guard.port}"
    assert f"connect-src http://{own} ws://{own} data: blob:" in policy
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert page.headers.get("Cache-Control") == "no-store"
    assert page.headers.get("Referrer-Policy") == "no-referrer"


@pytest.mark.parametrize(
    "wrong",
    [{"Cookie": ""}, {"Cookie": "instok3d_1=abcdefghijklmnopqrstuvwxyz"}, {"Host": "evil.example"},
     {"Origin": "http://evil.example"}],
)  # fmt: skip
def test_pages_and_websockets_are_refused_alike(guard: Guard, wrong: dict[str, str]):
    wrong = cookie(guard) | wrong
    for headers in (wrong, websocket(guard, **wrong)):
        answer = ask(guard, **headers)
        assert answer.status == 403
        assert answer.body.startswith(b"refused: ")
        assert answer.headers.get("Set-Cookie") is None
        assert guard.token.encode() not in answer.body


def test_a_websocket_of_our_page_is_opened(guard: Guard):
    assert ask(guard, **websocket(guard, **cookie(guard))).status == 101
    without_origin = websocket(guard, **cookie(guard))
    del without_origin["Origin"]
    assert ask(guard, **without_origin).status == 403


@pytest.mark.parametrize(
    "path", ["/../../../../etc/passwd", "/%2e%2e/%2e%2e/x", "/..%5c..%5cx", "/x"]
)
def test_no_file_is_served_but_the_page(guard: Guard, path: str):
    assert ask(guard, path, **cookie(guard)).status == 404


def test_the_server_listens_on_this_machine_alone(guard: Guard):
    # Any other address, such as the loopback's second one, leads to a server on all of them.
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", guard.port), timeout=60)


def test_a_taken_port_is_left_to_its_owner():
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        assert free_port("127.0.0.1", taken) != taken


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", -1), ("127.0.0.1", 65536)])
def test_what_is_no_port_is_refused(host: str, port: int):
    with pytest.raises(ValueError, match=f"port must be 0 .* got {port}"):
        free_port(host, port)


def test_an_address_of_another_machine_is_refused():
    with pytest.raises(ValueError, match=r"cannot listen on 203\.0\.113\.1"):
        serve("203.0.113.1", 8080, title="test", hover=lambda x, y: "")


def test_other_servers_of_the_process_are_left_alone(guard: Guard):
    from websockets.asyncio import server

    assert server.serve.__module__ == "websockets.asyncio.server"
