"""Takes the picture of the viewer in docs/viewing.md.

python docs/pictures/viewer.py SCENE.itk OBJECT [FILE.jpg]

Needs the extras view and dev, and Chromium.
"""

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from instok3d.scene.scene import Scene
from instok3d.viewer.app import Viewer
from instok3d.viewer.session import Session

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PATIENCE_MS = 300_000
"""A frame takes seconds in software."""
SETTLED_MS = 15_000
"""Until all splats are drawn, and have come out of the dark."""


def main() -> None:
    """Open the viewer with an object selected."""
    session = Session(Scene.load(sys.argv[1]))
    session.select(int(sys.argv[2]) if sys.argv[2].isdecimal() else sys.argv[2])
    output = Path(sys.argv[3]) if len(sys.argv) > 3 else Path(__file__).parent / "viewer.jpg"
    viewer = Viewer(session, host="127.0.0.1", port=0, token=None, title="InsTok3D")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport={"width": 1200, "height": 640})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(viewer.url)
        page.get_by_text("Gaussians").first.wait_for()
        # That WebGL runs in software is no news here.
        page.add_style_tag(content=".mantine-Notification-root { display: none }")
        page.wait_for_timeout(SETTLED_MS)
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        browser.close()
    viewer.stop()
    picture.save(output, quality=88)


if __name__ == "__main__":
    main()
