"""The documentation site: what its pages are made of, and that its checker sees faults.

`.ci/run` builds the whole site and checks it.
"""

import re
import runpy
from pathlib import Path

import pytest

yaml = pytest.importorskip("yaml")

ROOT = Path(__file__).resolve().parents[1]
PAGES = runpy.run_path(str(ROOT / "docs/site/pages.py"))
CHECK = runpy.run_path(str(ROOT / "docs/site/check.py"))
PICTURES = runpy.run_path(str(ROOT / "docs/pictures/examples.py"))
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text())


def relinked(markdown: str, source: str, page: str) -> str:
    known = {"docs/data.md": "data.md", "README.md": "index.md", "examples": "examples/00_a.md"}
    return PAGES["relinked"](markdown, source, page, known, lambda path: path == "runs/a.sh")


@pytest.mark.parametrize(
    ("link", "source", "page", "wanted"),
    [
        ("docs/data.md#files", "README.md", "index.md", "data.md#files"),
        ("data.md", "docs/formats.md", "formats.md", "data.md"),
        ("../README.md", "docs/formats.md", "formats.md", "index.md"),
        ("../examples", "docs/concepts.md", "concepts.md", "examples/00_a.md"),
        ("../docs/data.md", "examples/00_a.py", "examples/00_a.md", "../data.md"),
        ("docs/pictures/demo.jpg", "README.md", "index.md", "pictures/demo.jpg"),
        ("runs/a.sh", "README.md", "index.md", PAGES["REPOSITORY"] + "/runs/a.sh"),
        ("nowhere.md", "README.md", "index.md", "nowhere.md"),
        ("#files", "docs/data.md", "data.md", "#files"),
        ("https://example.org/a.md", "README.md", "index.md", "https://example.org/a.md"),
    ],
)
def test_links_between_files_become_links_between_pages(
    link: str, source: str, page: str, wanted: str
):
    assert relinked(f"a [b]({link}), c", source, page) == f"a [b]({wanted}), c"


def test_a_picture_that_is_a_link_is_led_on_twice():
    line = "[![a](docs/pictures/b.png)](docs/data.md)"
    assert relinked(line, "README.md", "index.md") == "[![a](pictures/b.png)](data.md)"


def test_a_page_without_links_stays():
    assert relinked("", "README.md", "index.md") == ""


def test_the_navigation_names_every_page_once():
    named = re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text().split("\nnav:")[1])
    made = {page for page in PAGES["site_pages"]().values() if not page.startswith("examples/")}
    assert sorted(named) == sorted(made | {"commands.md"})


@pytest.mark.parametrize("path", PAGES["example_files"](), ids=lambda path: path.stem)
def test_a_page_of_an_example_has_its_call_and_its_code(path: Path):
    page = PAGES["example_page"](path)
    assert re.match(r"# [A-Z][a-z]+\n\n.+\n\n```bash\npython examples/", page)
    code = re.findall(r"```python\n(.*?)```", page, re.S)
    assert len(code) == 1
    compile(code[0], path.name, "exec")


def test_each_example_has_a_picture():
    assert list(PICTURES["DRAWS"]) == [path.stem for path in PAGES["example_files"]()]


def test_the_site_asks_for_no_font_and_sets_nothing_that_asks_another_server():
    assert CONFIG["theme"]["font"] is False
    assert not {"repo_url", "extra_javascript", "extra_css"} & CONFIG.keys()


def site(folder: Path, body: str) -> list[str]:
    (folder / "a.html").write_text(f"<p id='top'>{body}</p>")
    (folder / "b.html").write_text("<h1 id='there'>b</h1>")
    return CHECK["faults"](folder)


@pytest.mark.parametrize(
    "body",
    [
        "", "<a href='b.html'>b</a>", "<a href='b.html#there'>b</a>", "<a href='#top'>a</a>",
        "<a href='https://example.org/x#y'>x</a>", "<a href='.'>here</a>",
        "<link rel='canonical' href='https://example.org/'>",
    ],
)  # fmt: skip
def test_a_site_whose_links_lead_somewhere_has_no_faults(tmp_path: Path, body: str):
    (tmp_path / "index.html").touch()
    assert site(tmp_path, body) == []


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("<a href='c.html'>c</a>", "a.html links to c.html: there is no such file"),
        ("<a href='b.html#here'>b</a>", "a.html links to b.html#here: the page has no such anchor"),
        ("<a href='../x.html'>x</a>", "a.html links to ../x.html: there is no such file"),
        ("<a href='/b.html'>b</a>", "a.html links to /b.html: it begins at the root of the server"),
        ("<img src='no.png'>", "a.html links to no.png: there is no such file"),
        (
            "<script src='https://example.org/x.js'></script>",
            "a.html loads https://example.org/x.js from another site",
        ),
        (
            "<link rel='stylesheet' href='//example.org/x.css'>",
            "a.html loads //example.org/x.css from another site",
        ),
    ],
)
def test_each_kind_of_fault_is_named(tmp_path: Path, body: str, fault: str):
    (tmp_path.parent / "x.html").touch()
    assert site(tmp_path, body) == [fault]


def test_a_folder_without_pages_is_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="build the site first"):
        CHECK["faults"](tmp_path)
