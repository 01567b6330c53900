"""Pages of the site that are not files of docs/: the README, the examples, the help of commands.

mkdocs calls the functions `on_*` (mkdocs.yml names this file under `hooks`). Links between pages
are those that work in the repository; here they are made to lead to pages of the site, and where
the site has no such page, into the repository.
"""

import ast
import json
import os
import posixpath
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
REPOSITORY = "https://github.com/instok3d/instok3d/blob/main"
PICTURES = "pictures/examples"
"""In docs/: what pictures.py made of the examples; pages without a picture lack it."""
TOP_PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
}
LINK = re.compile(r"\]\(([^)\s]+)\)")
HELP = """
import io, json
from contextlib import redirect_stdout
from importlib import import_module
from instok3d.cli import COMMANDS, main
words = [[]]
for name in COMMANDS:
    module = import_module(f"instok3d.cli.{name}")
    words += [[name], *([name, each] for each in getattr(module, "COMMANDS", {}))]
texts = []
for each in words:
    with redirect_stdout(io.StringIO()) as text:
        main([*each, "--help"])
    texts.append([" ".join(["instok3d", *each]), text.getvalue()])
print(json.dumps(texts))
"""


def example_files() -> list[Path]:
    """The scripts of examples/, in their order."""
    return sorted((ROOT / "examples").glob("[0-9]*.py"))


def site_pages() -> dict[str, str]:
    """The page of the site, as a path below docs/, of each file of the repository that has one."""
    pages = {f"docs/{path.name}": path.name for path in (ROOT / "docs").glob("*.md")}
    del pages["docs/README.md"]
    pages |= TOP_PAGES
    examples = example_files()
    pages |= {f"examples/{path.name}": f"examples/{path.stem}.md" for path in examples}
    return pages | {"examples": f"examples/{examples[0].stem}.md"}


def relinked(
    markdown: str, source: str, page: str, pages: Mapping[str, str], exists: Callable[[str], bool]
) -> str:
    """A page whose links between files of the repository lead to pages of the site.

    Args:
        markdown: The page.
        source: The file that it was written in, relative to the repository.
        page: Where it stands on the site, relative to docs/.
        pages: See `site_pages`.
        exists: Whether the repository has a file or folder; links to what it lacks are left alone,
            and mkdocs tells of them.
    """

    def changed(match: re.Match[str]) -> str:
        link = match[1]
        path, hash_, anchor = link.partition("#")
        if not path or "://" in link or link.startswith("mailto:"):
            return match[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if target in pages or target.startswith("docs/pictures/"):
            inside = pages.get(target, target.removeprefix("docs/"))
            path = posixpath.relpath(inside, posixpath.dirname(page) or ".")
            return f"]({path}{hash_}{anchor})"
        if exists(target):
            return f"]({REPOSITORY}/{target}{hash_}{anchor})"
        return match[0]

    return LINK.sub(changed, markdown)


def example_page(path: Path) -> str:
    """An example as a page: its docstring, what it draws, its code."""
    code = path.read_text()
    about = (ast.get_docstring(ast.parse(code)) or "").strip()
    title, _, rest = about.partition("\n\n")
    call, _, notes = rest.partition("\n\n")
    name = re.sub(r"^\d+_", "", path.stem).replace("_", " ").capitalize()
    parts = [f"# {name}", title, f"```bash\n{call}\n```", notes]
    picture = f"{PICTURES}/{path.stem}.jpg"
    if (ROOT / "docs" / picture).is_file():
        parts.append(f"![What {path.name} draws of the demo](../{picture})")
    body = code.split('"""', 2)[2].strip()
    parts.append(f"```python\n{body}\n```")
    return "\n\n".join(part for part in parts if part) + "\n"


def commands_page() -> str:
    """The help of every command, as the program prints it."""
    environment = os.environ | {"COLUMNS": "120", "NO_COLOR": "1"}
    ended = subprocess.run(
        [sys.executable, "-c", HELP], env=environment, capture_output=True, text=True, check=True
    )
    parts = ["# Commands", "What each prints with `--help`."]
    for name, text in json.loads(ended.stdout):
        parts.append(
            f"{'##' if name.count(' ') < 2 else '###'} {name}\n\n```text\n{text.rstrip()}\n```"
        )
    return "\n\n".join(parts) + "\n"


def on_config(config: Any) -> Any:
    """The examples, which the navigation lists by number."""
    for entry in config.nav:
        if "Examples" in entry:
            entry["Examples"] = [f"examples/{path.stem}.md" for path in example_files()]
    return config


def on_files(files: Any, config: Any) -> Any:
    """All pages, those that are made here too."""
    from mkdocs.structure.files import File

    made = {page: (ROOT / source).read_text() for source, page in TOP_PAGES.items()}
    made |= {f"examples/{path.stem}.md": example_page(path) for path in example_files()}
    made["commands.md"] = commands_page()
    for page, content in made.items():
        files.append(File.generated(config, page, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """A page with links that lead to pages of the site."""
    pages = site_pages()
    uri = page.file.src_uri
    source = {made: file for file, made in pages.items()}.get(uri, f"docs/{uri}")
    return relinked(markdown, source, uri, pages, lambda target: (ROOT / target).exists())
