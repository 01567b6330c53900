"""The OpenAPI document of the HTTP API: made of the tools, so that it cannot differ from them."""

from typing import Any

from instok3d.service.pictures import MOST_BYTES
from instok3d.service.tool import JPEG, PNG, Tool
from instok3d.version import generator

JSON = "application/json"
SENT = (PNG, JPEG, "image/webp", "application/octet-stream")
"""Media types of pictures that are sent; the bytes tell what they are."""
REFUSALS = {
    "400": "An argument is unknown, missing, of another kind or out of range.",
    "403": "The token, the host name or the page that sent the request is not the right one.",
    "404": "There is no such scene, object or view.",
    "405": "Another method than that of the address.",
    "409": "The scene does not allow it: no free spot, no semantics, words not understood, others.",
    "500": "A fault in the program.",
}
REFUSED_PICTURES = {"413": f"The picture has more than {MOST_BYTES} bytes."}


def openapi_document(tools: tuple[Tool, ...]) -> dict[str, Any]:
    """OpenAPI 3.1 of `/api/NAME`, one path for each tool: POST of those that take a picture."""
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "instok3d",
            "version": generator().split()[1],
            "description": "Objects of 3D scenes: what they are, where they stand, how they look. "
            "Lengths are in scene units, which are metres where an answer says so.",
        },
        "security": [{"token": []}, {"token_in_address": []}],
        "paths": {
            f"/api/{tool.name}": {"post" if tool.takes_picture else "get": _operation(tool)}
            for tool in tools
        },
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
    refused = {JSON: {"schema": {"$ref": "#/components/schemas/Refusal"}}}
    answer = (
        {JSON: {"schema": {"type": "object"}}} if tool.picture_type is None
        else {tool.picture_type: {"schema": _bytes_of(tool.picture_type)}}
    )  # fmt: skip
    taken = {"requestBody": {
        "required": True, "description": "The bytes of a picture of one thing.",
        "content": {each: {"schema": _bytes_of(each)} for each in SENT},
    }} if tool.takes_picture else {}  # fmt: skip
    refusals = REFUSALS | (REFUSED_PICTURES if tool.takes_picture else {})
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
               for code, words in refusals.items()},
        },
        **taken,
    }  # fmt: skip


def _bytes_of(media_type: str) -> dict[str, Any]:
    return {"type": "string", "contentMediaType": media_type, "minLength": 1}
