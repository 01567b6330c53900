"""The HTTP server: the tools as `/api/NAME`, their OpenAPI document, and MCP at `/mcp`.

Each request passes the viewer's `Guard` first. Scenes and libraries are opened before the server
starts, and no argument is a path.
"""

import json
import logging
import threading
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl

from instok3d.errors import MissingWeightsError
from instok3d.files import json_text
from instok3d.service.openapi import openapi_document
from instok3d.service.parameters import ArgumentError
from instok3d.service.pictures import MOST_BYTES
from instok3d.service.tool import Picture, Tool, Tools
from instok3d.viewer.guard import Guard

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

MOST_BODY = 64 * 1024
"""Bytes of a request to MCP."""
MOST_ARGUMENTS = 32
"""Of an address."""
FORGOTTEN = 8
"""How often the limit of pictures is read of a body that is too large."""
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
"""Of every answer."""
Receive = Callable[[], Awaitable[dict[str, Any]]]
Send = Callable[[dict[str, Any]], Awaitable[None]]
App = Callable[[dict[str, Any], Receive, Send], Awaitable[None]]
_LOG = logging.getLogger(__name__)


def require_service() -> None:
    """Check that the packages of the extra `serve` are there.

    Raises:
        ModuleNotFoundError: One is not; says how to install them.
    """
    try:
        import mcp  # noqa: F401
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"serving needs the package {error.name}: pip install 'instok3d[serve]'"
        ) from error


def service_app(served: Sequence[Tools], guard: Guard) -> App:
    """The ASGI app of scenes, of a library or of both, behind a guard."""
    from starlette.concurrency import run_in_threadpool
    from starlette.responses import Response
    from starlette.routing import Route

    from instok3d.service.mcp_server import mcp_app

    tools = tuple(tool for each in served for tool in each.tools())
    document = json.dumps(openapi_document(tools)).encode()

    def endpoint(tool: Tool) -> "Callable[[Request], Awaitable[Response]]":
        async def answer(request: "Request") -> "Response":
            body = await _picture_of(request) if tool.takes_picture else b""
            if body is None:
                words = f"the picture has more than {MOST_BYTES} bytes: send a smaller one"
                return Response(_refusal(words), 413, media_type="application/json")
            return await run_in_threadpool(_answer, tool, request.url.query, body)

        return answer

    async def openapi(request: "Request") -> "Response":
        return Response(document, media_type="application/json")

    routes = [
        Route(
            f"/api/{tool.name}", endpoint(tool), methods=["POST" if tool.takes_picture else "GET"]
        )
        for tool in tools
    ]
    routes.append(Route("/openapi.json", openapi, methods=["GET"]))
    app: Any = mcp_app(tools, guard, routes)
    app.add_exception_handler(404, _plain(404, "there is nothing here; /openapi.json says what is"))
    app.add_exception_handler(
        405, _plain(405, "this address takes another method: /openapi.json says which")
    )
    return guarded(app, guard)


def guarded(app: App, guard: Guard) -> App:
    """An app that answers only what the guard lets through.

    Tokens may come as `Authorization: Bearer`, as programs send them, too.
    """

    async def check(scope: dict[str, Any], receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await (app(scope, receive, send) if scope["type"] == "lifespan" else _end(send))
            return
        sent = [(name.decode("latin-1").lower(), value.decode("latin-1"))
                for name, value in scope["headers"]]  # fmt: skip

        def header(name: str) -> Sequence[str]:
            found = [value for each, value in sent if each == name.lower()]
            if name == "Cookie":
                bearers = [
                    value[7:].strip()
                    for each, value in sent
                    if each == "authorization" and value[:7].lower() == "bearer "
                ]
                found += [f"{guard.cookie}={token}" for token in bearers]
            return found

        target = f"/?{scope['query_string'].decode('latin-1')}"
        reason = guard.refusal(target, header)

        async def sealed(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                names = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [
                    *message["headers"],
                    *((name.lower().encode(), value.encode()) for name, value in HEADERS.items()
                      if name.lower().encode() not in names),
                ]  # fmt: skip
            await send(message)

        if reason is not None:
            from starlette.responses import Response

            response = Response(_refusal(f"refused: {reason}"), 403, media_type="application/json")
            await response(scope, receive, sealed)  # type: ignore[arg-type]
            return
        await app(scope, receive, sealed)

    return check


@contextmanager
def serving(served: Sequence[Tools], guard: Guard) -> Iterator[None]:
    """Serve scenes, a library or both during the block, from another thread.

    Raises:
        ValueError: The server did not start.
    """
    import uvicorn

    config = uvicorn.Config(
        service_app(served, guard), host=guard.host, port=guard.port, log_level="error",
        access_log=False, server_header=False, proxy_headers=False, backlog=4096, ws="none",
        timeout_graceful_shutdown=5,
    )  # fmt: skip
    server = uvicorn.Server(config)
    started = threading.Event()
    thread = threading.Thread(target=_run, args=(server, started), daemon=True)
    thread.start()
    while not server.started and thread.is_alive():
        started.wait(0.02)
    if not server.started:
        raise ValueError(f"cannot listen on {guard.host}, port {guard.port}; give another --port")
    try:
        yield
    finally:
        server.should_exit = True
        thread.join(10)


def _run(server: Any, ended: threading.Event) -> None:
    try:
        server.run()
    finally:
        ended.set()


async def _picture_of(request: "Request") -> bytes | None:
    """The body of a request; None where it is larger than pictures may be.

    Somewhat larger ones are read to their end and forgotten, since many clients read no answer
    before they have sent all.
    """
    from starlette.requests import ClientDisconnect

    parts, size = [], 0
    with suppress(ClientDisconnect):  # nobody is there for an answer
        async for part in request.stream():
            size += len(part)
            if size <= MOST_BYTES:
                parts.append(part)
            elif size > FORGOTTEN * MOST_BYTES:
                break
    return b"".join(parts) if size <= MOST_BYTES else None


def _answer(tool: Tool, query: str, body: bytes) -> "Response":
    """The answer of a tool to the query of an address and the body of a request."""
    from starlette.responses import Response

    try:
        if query.count("&") >= MOST_ARGUMENTS:
            raise ArgumentError(f"an address has at most {MOST_ARGUMENTS} arguments")
        pairs = parse_qsl(query, keep_blank_values=True, errors="strict")
        names = [name for name, _ in pairs if name != "token"]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ArgumentError(f"{twice[0][:40]} was given twice: give it once")
        found = tool.run({name: value for name, value in pairs if name != "token"}, body)
        if isinstance(found, Picture):
            return Response(found.data, media_type=found.media_type)
        return Response(json_text(found), media_type="application/json")
    except Exception as error:
        status, words = refusal_of(error)
        return Response(_refusal(words), status, media_type="application/json")


def refusal_of(error: Exception) -> tuple[int, str]:
    """The status and the sentence for an error; faults of the program are logged, not told."""
    words = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    if isinstance(error, KeyError):
        return 404, words
    if isinstance(error, UnicodeDecodeError):
        return 400, "the address holds bytes that are no UTF-8"
    if isinstance(error, ArgumentError):
        return 400, words
    if isinstance(error, ValueError | MemoryError):
        return 409, words
    if isinstance(error, MissingWeightsError):
        return 409, "the encoder that reads texts is not installed on this server"
    _LOG.error("a request failed", exc_info=error)
    return 500, "a fault in the program; its log has more"


def _refusal(words: str) -> bytes:
    return json.dumps({"error": words}).encode("utf-8", "replace")


def _plain(status: int, words: str) -> "Callable[[Request, Exception], Awaitable[Response]]":
    async def answer(request: "Request", error: Exception) -> "Response":
        from starlette.responses import Response

        more = getattr(error, "headers", None) or {}  # which methods there are
        return Response(_refusal(words), status, more, media_type="application/json")

    return answer


async def _end(send: Send) -> None:
    await send({"type": "websocket.close", "code": 1008})
