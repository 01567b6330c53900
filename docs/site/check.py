"""Checks a built site: every link within it leads somewhere, and no page loads from elsewhere.

python docs/site/check.py site

mkdocs checks the links of Markdown; this looks at the pages as they came out, with the links that
the theme and the reference made. Links to other sites are not followed.
"""

import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"link": "href", "script": "src", "img": "src", "iframe": "src", "source": "src"}
"""Elements whose address a browser asks for by itself."""
ONLY_NAMED = {"canonical", "next", "prev", "license", "me"}
"""Values of `rel` of a <link> that no browser asks for."""


@dataclass
class Page(HTMLParser):
    """The anchors of a page, what it links to, and what it loads."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take note of an element."""
        values = {name: value for name, value in attrs if value is not None}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        named = tag == "link" and values.get("rel", "") in ONLY_NAMED
        if LOADED.get(tag) in values and not named:
            self.loaded.append(values[LOADED[tag]])


def faults(site: Path) -> list[str]:
    """One sentence for each link that leads nowhere and each thing that is loaded from elsewhere.

    Raises:
        FileNotFoundError: There is no site.
    """
    pages: dict[Path, Page] = {}
    for path in sorted(site.rglob("*.html")):
        pages[path.resolve()] = Page()
        pages[path.resolve()].feed(path.read_text(encoding="utf-8"))
    if not pages:
        raise FileNotFoundError(f"no pages in {site}: build the site first, with mkdocs build")
    found = []
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        for link in page.loaded:
            if urlsplit(link).netloc:
                found.append(f"{name} loads {link} from another site")
        for link in [*page.links, *page.loaded]:
            fault = _fault_of(link, path, site.resolve(), pages)
            if fault:
                found.append(f"{name} links to {link}: {fault}")
    return sorted(set(found))


def _fault_of(link: str, path: Path, site: Path, pages: dict[Path, Page]) -> str:
    """What is wrong with one link of a page; empty where nothing is."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return ""
    if parts.path.startswith("/"):
        return "" if path.name == "404.html" else "it begins at the root of the server"
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.is_relative_to(site) or not target.exists():
        return "there is no such file"
    target = target / "index.html" if target.is_dir() else target
    anchor = unquote(parts.fragment)
    if anchor and not anchor.startswith("__") and target in pages:
        return "" if anchor in pages[target].anchors else "the page has no such anchor"
    return ""


def main() -> None:
    """Print the faults of a site; the exit code is 1 where there are some."""
    if len(sys.argv) != 2:
        sys.exit((__doc__ or "").strip())
    found = faults(Path(sys.argv[1]))
    print(
        "\n".join(found)
        or "all links within the site lead somewhere; nothing is loaded from outside"
    )
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
