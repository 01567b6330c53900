"""Our files in Spark, the splat renderer for three.js, in a browser."""

import functools
import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import torch

from browser import open_page
from instok3d.formats.registry import export_scene
from instok3d.formats.upright import FLIP
from splat_scenes import CORNER_COLORS, corner_scene, eight_corners

NODE = Path(os.environ.get("INSTOK3D_NODE_MODULES", "node_modules"))
PACKAGES = {
    "three": "three/build/three.module.js",
    "three/addons/": "three/examples/jsm/",
    "@sparkjsdev/spark": "@sparkjsdev/spark/dist/spark.module.js",
}
SUFFIXES = (".ply", ".splat", ".spz", ".compressed.ply", ".ksplat", ".sog")
PAGE = """<!doctype html><script type="importmap">{imports}</script><script type="module">
import {{ PackedSplats }} from "@sparkjsdev/spark";
async function read(name) {{
  const fileBytes = new Uint8Array(await (await fetch(name)).arrayBuffer());
  const splats = new PackedSplats({{ fileBytes, fileName: name }});
  await splats.initialized;
  const rows = [];
  splats.forEachSplat((index, center, scales, quaternion, opacity, color) =>
    rows.push([...center.toArray(), ...color.toArray()]));
  return rows;
}}
window.found = {{}};
for (const name of {names}) {{
  try {{ window.found[name] = await read(name); }}
  catch (error) {{ window.found[name] = String(error); }}
}}
window.done = true;
</script>"""


class Quiet(SimpleHTTPRequestHandler):
    """Serves files without a line on stderr for each."""

    def log_message(self, *_: object) -> None:
        return


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address at which this machine alone sees a folder: pages on disk import no modules."""
    handler = functools.partial(Quiet, directory=str(folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What Spark read, by the name of the file: rows of place and colour, or an error."""
    if not (NODE / PACKAGES["@sparkjsdev/spark"]).is_file():
        pytest.skip("Spark is not here: npm install @sparkjsdev/spark three and set "
                    "INSTOK3D_NODE_MODULES")  # fmt: skip
    pytest.importorskip("gaussforge")
    folder = tmp_path_factory.mktemp("spark")
    names = [f"a{suffix}" for suffix in SUFFIXES]
    for name in names:
        export_scene(corner_scene(), folder / name)
    (folder / "packages").symlink_to(NODE.resolve())
    imports = {package: f"./packages/{path}" for package, path in PACKAGES.items()}
    page = PAGE.format(imports=json.dumps({"imports": imports}), names=json.dumps(names))
    (folder / "page.html").write_text(page)
    with served(folder) as address, open_page(f"{address}/page.html", "window.done") as opened:
        assert all(asked.startswith((address, "blob:", "data:")) for asked in opened.asked)
        return opened.evaluate("window.found")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_spark_finds_each_colour_in_its_corner(found: dict[str, Any], suffix: str):
    assert isinstance(found[f"a{suffix}"], list), found[f"a{suffix}"]
    rows = torch.tensor(found[f"a{suffix}"])
    # It keeps the axes of spz, y up and z backward, which are those of three.js.
    places = rows[:, :3] @ FLIP if suffix == ".spz" else rows[:, :3]
    assert len(rows) == len(CORNER_COLORS)
    for place, color in zip(eight_corners().means, CORNER_COLORS, strict=True):
        row = (places - place).abs().sum(dim=1).argmin()
        torch.testing.assert_close(places[row], place, atol=0.01, rtol=0)
        torch.testing.assert_close(rows[row, 3:], color, atol=0.02, rtol=0)
