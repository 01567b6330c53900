"""The OpenAPI document of the HTTP API: made of the tools, so that it cannot differ from them."""

from typing import Any

from instok3d.service.tools import Tool
from instok3d.version import generator

JSON, PNG = "application/json", "image/png"
REFUSALS = {
    "400": "An argument is unknown, missing, of another kind or out of range.",
    "403": "The token, the host name or the page that sent the request is not the right one.",
    "404": "There is no such scene, object or view.",
    "405": "Another method than GET.",
    "409": "The scene does not allow it: no free spot, no semantics, words not understood, others.",
    "500": "A fault in the program.",
}


def openapi_document(tools: tuple[Tool, ...]) -> dict[str, Any]:
    """OpenAPI 3.1 of `GET /api/NAME`, one path for each tool."""
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "instok3d",
            "version": generator().split()[1],
            "description": "Objects of 3D scenes: what they are, where they stand, how they look. "
            "Lengths are in scene units, which are metres where an answer says so.",
        },
        "security": [{"token": []}, {"token_in_address": []}],
        "paths": {f"/api/{tool.name}": {"get": _operation(tool)} for tool in tools},
        "components": {
            "securitySchemes": {
                "token": {"type": "http", "scheme": "bearer"},
                "token_in_address": {"type": "apiKey", "in": "query", "name": "token"},
            },
            "schemas": {
                "Refusal": {
                    "type": "object",
                    "properties": {"error": {"type": "string"}},
                    "required": ["error"],
                }
            },
        },
    }


def _operation(tool: Tool) -> dict[str, Any]:
    given = {PNG: {"schema": {"type": "string", "contentMediaType": PNG}}}
    refused = {JSON: {"schema": {"$ref": "#/components/schemas/Refusal"}}}
    answer = given if tool.gives_picture else {JSON: {"schema": {"type": "object"}}}
    return {
        "operationId": tool.name,
        "summary": tool.about,
        "parameters": [
            {"name": each.name, "in": "query", "required": each.required,
             "description": each.about, "schema": each.schema()}
            for each in tool.parameters
        ],
        "responses": {
            "200": {"description": tool.about, "content": answer},
            **{code: {"description": words, "content": refused}
               for code, words in REFUSALS.items()},
        },
    }  # fmt: skip
