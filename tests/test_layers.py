"""A file imports only from its own folder and from folders before it in ORDER."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1] / "src" / "instok3d"
ORDER = ["types", "errors", "files", "locking", "pictures", "geometry", "render", "photos",
         "data", "rooms", "datasets", "weights", "backbones", "model", "semantics", "objectives",
         "scene", "evaluation", "training", "baselines", "viewer", "cli"]  # fmt: skip


def imported_layers(tree: ast.AST) -> set[str]:
    layers = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "instok3d":
            layers |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("instok3d."):
            layers.add((node.module or "").split(".")[1])
        elif isinstance(node, ast.Import):
            layers |= {a.name.split(".")[1] for a in node.names if a.name.startswith("instok3d.")}
    return {layer for layer in layers if layer in ORDER or (ROOT / layer).exists()}


def test_imports_point_back():
    for path in ROOT.rglob("*.py"):
        layer = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if layer in ("__init__", "__main__"):
            continue
        assert layer in ORDER, f"{path.relative_to(ROOT)}: give the folder a place in ORDER"
        found = imported_layers(ast.parse(path.read_text()))
        later = [name for name in found if ORDER.index(name) > ORDER.index(layer)]
        assert not later, f"{path.relative_to(ROOT)} imports {later}, which come after {layer}"


def test_an_import_upward_is_seen():
    tree = ast.parse("from instok3d.cli.main import x\nimport instok3d.training.loop\n")
    assert imported_layers(tree) == {"cli", "training"}
