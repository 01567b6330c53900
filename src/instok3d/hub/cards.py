"""The text of a repository's page: what it holds, how it is used, and the hash of each file."""

import json
from collections.abc import Mapping, Sequence

from instok3d.hub.manifest import Manifest

MARK = "<!-- written by instok3d; without this line the next push leaves the card as it is -->"


def card_text(
    metadata: Mapping[str, object], title: str, parts: Sequence[str], manifest: Manifest
) -> str:
    """A card in Markdown, with what the hub reads of it in front.

    Args:
        metadata: Keys and values that the hub knows, such as license.
        title: Of the page.
        parts: Paragraphs, tables and code.
        manifest: Of the files.
    """
    head = [f"{key}: {json.dumps(value)}" for key, value in metadata.items()]  # JSON is YAML
    rows = [(name, each.bytes, f"`{each.sha256}`") for name, each in manifest.files.items()]
    files = table(("file", "bytes", "SHA-256"), rows)
    body = [MARK, f"# {title}", *parts, "## Files", files, _CHECKED]
    return "---\n" + "\n".join(head) + "\n---\n\n" + "\n\n".join(body) + "\n"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown; bars and line breaks in its cells are made harmless."""
    lines = [_row(head), "|" + "---|" * len(head), *map(_row, rows)]
    return "\n".join(lines)


def bash(*lines: str) -> str:
    """Commands in Markdown."""
    return "\n".join(["```bash", *lines, "```"])


def _row(cells: Sequence[object]) -> str:
    words = (" ".join(str(cell).split()).replace("|", "\\|") for cell in cells)
    return f"| {' | '.join(words)} |"


_CHECKED = (
    "`instok3d` fetches these files alone, JSON, safetensors and PNG, and refuses one with another "
    "hash. A commit behind the name (`@COMMIT`) gives the same files at any time."
)
