"""What source distribution and wheel hold, and that an installed package knows its commit."""

import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ASSETS = Path("src/instok3d/assets")
BUILD = "import sys, scikit_build_core.build as b; getattr(b, sys.argv[1])(sys.argv[2])"


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.strip()


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository of the project's files, with a small file in the model's place."""
    pytest.importorskip("scikit_build_core")
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("what belongs to the project is asked from git, which is not here")
    copy = tmp_path_factory.mktemp("tree")
    for name in run("git", "ls-files", "-co", "--exclude-standard", cwd=ROOT).splitlines():
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    (copy / ASSETS / "default_model.safetensors").write_bytes(b"model")
    alone = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    for words in (["init", "-q"], ["add", "-A"], [*alone, "commit", "-q", "-m", "all"]):
        run("git", *words, cwd=copy)
    return copy


@pytest.fixture(scope="module")
def sdist(tree: Path) -> Path:
    """The unpacked source distribution."""
    run(sys.executable, "-c", BUILD, "build_sdist", tree.parent / "dist", cwd=tree)
    (file,) = (tree.parent / "dist").glob("*.tar.gz")
    with tarfile.open(file) as archive:
        # Before 3.11.4 there are no filters; the archive was made two lines above.
        archive.extraction_filter = getattr(tarfile, "data_filter", None)
        archive.extractall(tree.parent)
    return tree.parent / file.name.removesuffix(".tar.gz")


@pytest.fixture(scope="module")
def wheel(sdist: Path) -> Path:
    """A wheel built from the source distribution where there is no compiler."""
    output = sdist.parent / "wheel"
    run(
        "env", "CXX=no-such-compiler", sys.executable, "-c", BUILD, "build_wheel", output, cwd=sdist
    )
    return next(output.glob("*.whl"))


def test_the_source_distribution_holds_what_a_build_needs_and_no_tests(sdist: Path):
    assert {path.name for path in sdist.iterdir()} == {
        "CHANGELOG.md", "CMakeLists.txt", "COMMIT", "CONTRIBUTING.md", "LICENSE", "NOTICE",
        "PKG-INFO", "README.md", "SECURITY.md", "constraints-cpu.txt", "docs", "examples",
        "pyproject.toml", "src",
    }  # fmt: skip
    assert (sdist / "src/instok3d/render/native/module.cpp").is_file()
    assert not list(sdist.rglob("test_*"))
    assert not list(sdist.rglob("*.so"))


def test_the_wheel_holds_code_assets_and_the_mark_of_types_but_no_sources_of_kernels(wheel: Path):
    names = zipfile.ZipFile(wheel).namelist()
    here = {str(path.relative_to(ROOT / "src")) for path in (ROOT / "src").rglob("*.py")}
    assets = {str(path.relative_to(ROOT / "src")) for path in (ROOT / ASSETS).rglob("*.*")}
    page = {
        str(path.relative_to(ROOT / "src"))
        for folder in ("webpage", "viewer")
        for path in (ROOT / "src/instok3d" / folder).iterdir()
        if path.suffix in (".js", ".css", ".html")
    }
    assert here | assets | page | {"instok3d/py.typed", "instok3d/COMMIT"} == {
        name for name in names if ".dist-info/" not in name
    }
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert any(name.endswith("licenses/NOTICE") for name in names)


def test_an_installed_package_knows_what_it_was_built_from(tree: Path, wheel: Path, tmp_path: Path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    # Isolated and without site, or the hook of an editable install would find the source tree.
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import instok3d.version as v; "
        "print(v.__file__, v.current_commit())"
    )
    said = run(sys.executable, "-I", "-S", "-c", code, cwd=tmp_path)
    head = run("git", "rev-parse", "HEAD", cwd=tree)
    assert said == f"{tmp_path / 'instok3d' / 'version.py'} {head}"


def test_addresses_of_the_project_are_those_of_one_repository():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    urls = project["urls"]
    assert {"Homepage", "Repository", "Issues"} <= set(urls)
    assert all(url.startswith(urls["Repository"]) for url in urls.values())
