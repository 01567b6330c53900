"""Runs the examples on the demo's scene and keeps what they draw, for the pages of the site.

python docs/pictures/examples.py [FOLDER]

Without a folder: docs/pictures/examples, which git ignores. 05_insert.py needs the extra `rooms`;
07_import.py imports what 06_export.py wrote.
"""

import os
import runpy
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from instok3d.pictures import Section, contact_sheet

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
DRAWS = {
    "00_reconstruct": "demo.itk/previews/contact_sheet.png",
    "01_look": "look.png",
    "02_isolate": "alone.png",
    "03_remove": "removed.png",
    "04_move": "moved.png",
    "05_insert": "inserted.png",
    "06_export": "exported/objects/*.png",
    "07_import": "imported.png",
}
"""The picture that each example leaves in the folder that it runs in; several go on one sheet."""
ARGUMENTS = {"07_import": ["exported/room.spz", "imported.itk"]}


def main() -> None:
    """Run them in order; what they print is shown."""
    given = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "examples"
    output = given.resolve()
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        os.chdir(work)
        for name, drawn in DRAWS.items():
            sys.argv = [name, *ARGUMENTS.get(name, [])]
            runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
            found = [Image.open(path).convert("RGB") for path in sorted(Path(work).glob(drawn))]
            cells = [np.asarray(picture) for picture in found]
            sheet = found[0] if len(found) == 1 else contact_sheet([Section("", cells)], columns=7)
            sheet.save(output / f"{name}.jpg", quality=90)
        os.chdir(output)


if __name__ == "__main__":
    main()
