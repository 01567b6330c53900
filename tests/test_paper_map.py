"""Everything that docs/paper_map.md names is in the source: code and tests."""

import ast
import re
from pathlib import Path

import pytest

from instok3d.training.config import PRESETS

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "paper_map.md"
CODE, TESTS = ROOT / "src" / "instok3d", ROOT / "tests"
REFERENCE = re.compile(r"`([\w/]+\.py):([\w.]+)`")


def names_in(body: list[ast.stmt], prefix: str = "") -> set[str]:
    """Functions, classes, methods, fields and constants of a module, as Class.member."""
    names = set()
    for node in body:
        if isinstance(node, ast.FunctionDef):
            names.add(prefix + node.name)
        elif isinstance(node, ast.ClassDef):
            names |= {prefix + node.name} | names_in(node.body, f"{prefix}{node.name}.")
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(prefix + node.target.id)
        elif isinstance(node, ast.Assign):
            names |= {prefix + t.id for t in node.targets if isinstance(t, ast.Name)}
    return names


def missing(text: str) -> list[str]:
    """References of a page that lead nowhere."""
    lost = []
    for file, name in REFERENCE.findall(text):
        is_test = Path(file).name.startswith("test_")
        path = (TESTS if is_test else CODE) / file
        if not path.is_file() or name not in names_in(ast.parse(path.read_text()).body):
            lost.append(f"{file}:{name}")
    return lost


def rows(text: str) -> list[list[str]]:
    """Cells of all table rows that are no head."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if row[0] not in ("paper", "part") and not set(row[0]) <= {"-"}]


def test_everything_the_page_names_exists():
    assert missing(PAGE.read_text()) == []


def test_every_row_names_code_and_a_test_or_says_that_there_is_none():
    found = rows(PAGE.read_text())
    assert len(found) > 30
    for row in found:
        code, test = row[-2:]
        if "not there yet" in row:
            assert test == "-", row
        else:
            assert REFERENCE.fullmatch(code), row
            assert REFERENCE.fullmatch(test), row
            assert REFERENCE.findall(test)[0][1].startswith("test_"), row


def test_every_equation_of_the_paper_has_a_row():
    named = " ".join(row[0] for row in rows(PAGE.read_text()))
    assert set(re.findall(r"Eq\. (\d)", named)) == set("12345678")


def test_every_table_of_the_paper_has_a_row():
    named = " ".join(row[0] for row in rows(PAGE.read_text()))
    assert set(re.findall(r"Tab\. (\d)", named)) == set("123456")


def test_presets_and_page_name_the_same_runs():
    text = PAGE.read_text()
    assert all(f"`{name}`" in text for name in PRESETS if name.startswith(("scannet", "re10k")))


@pytest.mark.parametrize(
    "wrong",
    [
        "model/grouping.py:assign_anchor",
        "model/group.py:assign_anchors",
        "model/tokenizer.py:TokenizerConfig.widths",
        "model/test_grouping.py:test_that_nobody_wrote",
    ],
)
def test_a_wrong_name_is_seen(wrong: str):
    assert missing(f"`{wrong}` and `model/grouping.py:assign_anchors`") == [wrong]
