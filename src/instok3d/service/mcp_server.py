"""The tools over the Model Context Protocol, by its official package (streamable HTTP)."""

import base64
from typing import Any

from instok3d.files import json_text
from instok3d.service.parameters import arguments_schema
from instok3d.service.tool import Picture, Tool
from instok3d.version import generator
from instok3d.viewer.guard import Guard

ABOUT = (
    "Rooms as 3D scenes of objects. Begin with list_scenes and describe, or with library_scenes "
    "and library_query, whichever is there. Objects of scenes are named by key, such as chair#3. "
    "Lengths are metres only where an answer says so."
)


def mcp_app(tools: tuple[Tool, ...], guard: Guard, routes: list[Any]) -> Any:
    """A Starlette app with MCP at `/mcp` and other routes.

    Tools that take pictures are left out: arguments are texts here, and requests small.

    Host names and origins are checked by the guard, not here.
    """
    from mcp import types
    from mcp.server.lowlevel import Server
    from mcp.server.transport_security import TransportSecuritySettings
    from starlette.concurrency import run_in_threadpool

    from instok3d.service.web import MOST_BODY, refusal_of

    tools = tuple(tool for tool in tools if not tool.takes_picture)
    known = {tool.name: tool for tool in tools}

    async def list_tools(context: Any, params: Any) -> types.ListToolsResult:
        return types.ListToolsResult(tools=[
            types.Tool(name=tool.name, description=tool.about,
                       input_schema=arguments_schema(tool.parameters),
                       annotations=types.ToolAnnotations(read_only_hint=True))
            for tool in tools
        ])  # fmt: skip

    async def call_tool(context: Any, params: types.CallToolRequestParams) -> types.CallToolResult:
        tool = known.get(params.name)
        try:
            if tool is None:
                raise KeyError(f"no tool {params.name[:40]!r}; there are: {', '.join(known)}")
            found = await run_in_threadpool(tool.run, params.arguments or {})
            said = "" if isinstance(found, Picture) else json_text(found)
        except Exception as error:
            words = types.TextContent(type="text", text=refusal_of(error)[1])
            return types.CallToolResult(content=[words], is_error=True)
        if isinstance(found, Picture):
            data = base64.b64encode(found.data).decode()
            shown = types.ImageContent(type="image", data=data, mime_type=found.media_type)
            return types.CallToolResult(content=[shown])
        words = types.TextContent(type="text", text=said)
        return types.CallToolResult(content=[words], structured_content=found)

    server = Server(
        "instok3d", version=generator().split()[1], instructions=ABOUT,
        on_list_tools=list_tools, on_call_tool=call_tool,
    )  # fmt: skip
    return server.streamable_http_app(
        streamable_http_path="/mcp", json_response=True, stateless_http=True,
        max_request_body_size=MOST_BODY, custom_starlette_routes=routes,
        transport_security=TransportSecuritySettings(enable_dns_rebinding_protection=False),
    )  # fmt: skip
