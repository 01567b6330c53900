"""What the README says works: its commands, its Python, its paths and links."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from command_lines import parses
from instok3d.cli import COMMANDS, main
from made_model import made_model, made_photos
from shipped_demo import ShippedDemo

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)


def section(title: str) -> str:
    return README.split(f"\n## {title}\n")[1].split("\n## ")[0]


def command_lines(text: str) -> list[list[str]]:
    lines = "\n".join(blocks(text, "bash")).splitlines()
    return [words for words in (shlex.split(line, comments=True) for line in lines) if words]


def our_words(words: list[str]) -> list[str] | None:
    """What follows `instok3d`, or `torchrun ... -m instok3d`; None for commands of others."""
    if words[0] == "torchrun":
        words = words[words.index("-m") + 1 :]
    return words[1:] if words[0] == "instok3d" else None


OURS = [ours for words in command_lines(README) if (ours := our_words(words)) is not None]


def test_first_result_and_tests_are_two_commands_each():
    first, test = command_lines(section("First result")), command_lines(section("Tests"))
    assert first == [["pip", "install", "-c", "constraints-cpu.txt", "."], ["instok3d", "demo"]]
    assert len(test) == 2


def test_the_test_commands_are_those_of_the_ci_word_for_word():
    ci = (ROOT / ".ci" / "run").read_text().splitlines()
    commands = blocks(section("Tests"), "bash")[0].splitlines()
    start = ci.index(commands[0])
    assert ci[start : start + len(commands)] == commands


def test_contributing_begins_with_the_same_commands():
    page = (ROOT / "CONTRIBUTING.md").read_text()
    assert blocks(page, "bash")[0] == blocks(section("Tests"), "bash")[0]


@pytest.mark.parametrize("words", OURS, ids=" ".join)
def test_the_command_line_takes_what_the_readme_writes(
    words: list[str], monkeypatch: pytest.MonkeyPatch
):
    assert parses(words, monkeypatch)


@pytest.mark.parametrize(
    "wrong",
    ["reconstruct photos/ --out room.itk", "data rooms --seeds 0:2", "evaluate rooms-3view"],
)
def test_a_wrong_command_is_seen(wrong: str, monkeypatch: pytest.MonkeyPatch):
    assert not parses(wrong.split(), monkeypatch)


def test_the_table_of_commands_names_all_of_them():
    assert re.findall(r"^\| `instok3d (\w+)` \|", README, re.M) == list(COMMANDS)


@pytest.mark.parametrize("code", blocks(README, "python"), ids=lambda code: code.split()[1])
@pytest.mark.filterwarnings("ignore:.*trained on rendered rooms alone")
def test_the_python_runs(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    made_photos(tmp_path / "photos")
    model = made_model(tmp_path / "model.safetensors")
    for module in ("instok3d.scene.reconstruct", "instok3d.model.files"):
        monkeypatch.setattr(f"{module}.DEFAULT_MODEL", model)
    monkeypatch.setattr("instok3d.scene.lifting.SHIPPED", tmp_path / "none")  # of another model
    monkeypatch.chdir(tmp_path)
    # In the folder where the commands above it have run.
    commands = [our_words(words) for words in command_lines(section("Your photos"))]
    assert [words[0] for words in commands if words] == ["reconstruct", "info", "render", "export"]
    assert all(words and main(words) == 0 for words in commands)
    exec(compile(code, "README.md", "exec"), {})
    assert (tmp_path / "room.itk" / "scene.json").is_file()


def test_the_first_result_comes_out(
    shipped_demo: ShippedDemo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    scene = shipped_demo.scene
    named = re.findall(r"`demo\.itk/(\S+)`", section("First result"))
    assert named
    assert all((scene / path).is_file() for path in named)
    drawn = re.findall(r"`instok3d (render demo\.itk [^`]+)`", section("Your photos"))
    assert len(drawn) == 1
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo.itk").symlink_to(scene)
    assert main(shlex.split(drawn[0])) == 0
    assert (tmp_path / "object.png").is_file()


def test_the_file_tree_names_what_is_there():
    paths = [line.split()[0] for line in blocks(README, "text")[0].splitlines()]
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / path).exists()] == []


PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path):
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", path.read_text())
    local = [link for link in links if "://" not in link]
    assert [link for link in local if not (path.parent / link).exists()] == []


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 200


def test_training_is_one_script_with_what_it_needs():
    install, script, use = command_lines(section("Train your own"))
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    assert install[-1] == ".[rooms]"
    assert "rooms" in extras
    assert script[0] == "bash"
    lines = (ROOT / script[1]).read_text()
    written = use[use.index("--model") + 1].removeprefix(f"{script[2]}/")
    assert f'-o "$folder/{written}"' in lines
