"""A viser server behind the guard. viser itself asks nobody who they are.

viser gives no hook for checks, so its function for incoming requests is wrapped when it opens its
port: pages and websockets pass `Guard` first, and answers get headers that keep the page to
itself. Its public tunnel is taken away, and uploads pass `UploadGate`.
"""

import asyncio
import http
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from instok3d.viewer.guard import Guard, random_token
from instok3d.viewer.uploads import UploadGate

if TYPE_CHECKING:
    import viser

TRIES = 100
"""Ports that are tried, from the one asked for on."""
STOP_S = 10.0
"""Longest wait for the end of a server's thread."""
_STARTING = threading.Lock()


def require_viser() -> None:
    """Check that viser is there.

    Raises:
        ModuleNotFoundError: It is not; says how to install it.
    """
    try:
        import viser  # noqa: F401
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the viewer needs the package viser: pip install 'instok3d[view]'"
        ) from error


def serve(
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    *,
    title: str,
    hover: Callable[[float, float], str],
    upload_limit_bytes: int = 0,
) -> tuple["viser.ViserServer", Guard]:
    """An empty viser server, and who may talk to it.

    Args:
        host: Address to listen on.
        port: The first one that is free from this on is taken; 0 takes any.
        token: None makes a random one.
        title: Shown at the head of the panel.
        hover: What the picture shows at x, y in [0, 1], in words; empty for nothing.
        upload_limit_bytes: Of a file that a browser may send; 0: none.

    Raises:
        ModuleNotFoundError: viser is not installed.
        ValueError: A bad token, an address that is not this machine's, or no free port.
        RuntimeError: This version of viser cannot be guarded.
    """
    require_viser()
    import viser
    from viser import _messages

    with _STARTING:
        guard = Guard(token or random_token(), host, free_port(host, port))
        with _guarding(guard, hover) as guarded, _viser_silent():
            server = viser.ViserServer(host, guard.port, label=title, verbose=False)
    if not guarded or server.get_port() != guard.port:
        stop_serving(server)
        raise RuntimeError(
            f"viser {viser.__version__} does not open its port as this program knows it, so that "
            "requests could not be checked: pip install 'instok3d[view]'"
        )
    sockets = server._websock_server
    for message in (
        _messages.ShareUrlRequest,
        _messages.ShareUrlDisconnect,
        _messages.FileTransferStartUpload,
        _messages.FileTransferPart,
    ):
        sockets.unregister_handler(message)
    if upload_limit_bytes:
        gate = UploadGate(server.gui, upload_limit_bytes)
        sockets.register_handler(_messages.FileTransferStartUpload, gate.start)
        sockets.register_handler(_messages.FileTransferPart, gate.part)
    return server, guard


def stop_serving(server: "viser.ViserServer") -> None:
    """End a server and its thread."""
    with _viser_silent():  # it prints a farewell from that thread
        server.stop()
        thread = server._websock_server._server_thread
        if thread is not None:
            thread.join(STOP_S)


@contextmanager
def _viser_silent() -> Iterator[None]:
    """Have viser print nothing, in any thread; all others print as before."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def free_port(host: str, first: int) -> int:
    """The first free port from one on, or any for 0.

    Raises:
        ValueError: It is no port, the address is not this machine's, or none is free.
    """
    if not 0 <= first <= 65535:
        raise ValueError(f"port must be 0 (any) or up to 65535, got {first}")
    error: OSError | None = None
    for port in range(first, min(first + TRIES, 65536)) if first else (0,):
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            with socket.create_server((host, port), family=family) as listening:
                return listening.getsockname()[1]
        except OSError as failure:
            error = failure
    raise ValueError(
        f"cannot listen on {host}, port {first} or the next {TRIES}: "
        f"{error.strerror if error else 'none is free'}; give another --host or --port"
    )


@contextmanager
def _guarding(guard: Guard, hover: Callable[[float, float], str]) -> Iterator[list[bool]]:
    """Put the guard before viser's own function for requests; the list says whether it was."""
    from websockets.asyncio import server as websockets_server

    original, guarded = websockets_server.serve, []

    def guarded_serve(*arguments: Any, **options: Any) -> Any:
        handler = options.get("process_request")
        if handler is None or getattr(handler, "__name__", "") != "viser_http_server":
            return original(*arguments, **options)
        guarded.append(True)
        return original(*arguments, **options | {"process_request": checked(guard, handler, hover)})

    websockets_server.serve = guarded_serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield guarded
    finally:
        websockets_server.serve = original


def checked(
    guard: Guard, handler: Callable[[Any, Any], Any], hover: Callable[[float, float], str]
) -> Callable[[Any, Any], Awaitable]:
    """A function for requests that asks the guard first, and adds `/hover` to viser's page."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    def answer(status: http.HTTPStatus, words: str, **more: str) -> Response:
        headers = Headers(**{"Content-Type": "text/plain; charset=utf-8"} | KEEP_TO_ITSELF | more)
        return Response(status, status.phrase, headers, words.encode())

    async def check(connection: Any, request: Any) -> Any:
        reason = guard.refusal(request.path, request.headers.get_all)
        if reason is not None:
            return answer(http.HTTPStatus.FORBIDDEN, f"refused: {reason}\n")
        if request.headers.get("Upgrade") is not None:
            return handler(connection, request)
        if guard.has_token(request.path):
            # The token goes from the address, where a screen shows it, into a cookie.
            cookie = f"{guard.cookie}={guard.token}; Path=/; HttpOnly; SameSite=Strict"
            more = {"Location": "/", "Set-Cookie": cookie}
            return answer(http.HTTPStatus.SEE_OTHER, "", **more)
        if request.path.partition("?")[0] == "/hover":
            place = place_of(request.path)
            if place is None:
                return answer(http.HTTPStatus.BAD_REQUEST, "wanted x and y in [0, 1]\n")
            return answer(http.HTTPStatus.OK, await asyncio.to_thread(hover, *place))
        if "Accept-Encoding" in request.headers:
            del request.headers["Accept-Encoding"]  # for a page as plain text
        response = handler(connection, request)
        if response is not None:
            if response.status_code == http.HTTPStatus.OK:
                script = (files("instok3d.viewer") / "hover.js").read_bytes()
                head = b"<script>" + script + b"</script></head>"
                response.body = response.body.replace(b"</head>", head, 1)
                del response.headers["Content-Length"]
                response.headers["Content-Length"] = str(len(response.body))
            response.headers.update(KEEP_TO_ITSELF)
            response.headers["Content-Security-Policy"] = policy(request.headers["Host"])
        return response

    return check


def place_of(target: str) -> tuple[float, float] | None:
    """The x and y in the query of an address; None where they are not numbers in [0, 1]."""
    try:
        query = parse_qs(urlsplit(target).query, max_num_fields=16)
        (x,), (y,) = query.get("x", []), query.get("y", [])
        place = float(x), float(y)
    except ValueError:
        return None
    return place if all(0 <= value <= 1 for value in place) else None


KEEP_TO_ITSELF = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Headers of every answer."""


def policy(host: str) -> str:
    """What the page may load and where it may send: nothing beyond this server."""
    return "; ".join([
        "default-src 'none'",
        # viser's page is one file, whose script unpacks the program into another inline script,
        # and its sorting of splats makes functions from text.
        "script-src 'unsafe-inline' 'unsafe-eval' blob:",
        "worker-src blob: data:",
        "style-src 'unsafe-inline'",
        "img-src data: blob:",
        "font-src data:",
        f"connect-src http://{host} ws://{host} data: blob:",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    ])  # fmt: skip
