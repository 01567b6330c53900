"""Which code made a result: a hash that changes where a result may, and not with every commit."""

import hashlib
from functools import cache
from pathlib import Path
from typing import Literal

PACKAGE = Path(__file__).resolve().parents[1]

TRAINING = ("types.py", "geometry", "render", "data", "rooms", "datasets", "backbones", "model",
            "semantics", "objectives", "baselines", "training", "tables/trained.py",
            "tables/trainings.py", "tables/work.py")  # fmt: skip
"""What a trained model depends on."""
MEASURING = (*TRAINING, "photos", "refinement", "scene", "evaluation", "tables/cells.py",
             "tables/features.py", "tables/kept_masks.py", "tables/measuring.py",
             "tables/data_sets.py", "tables/scene_sets.py")  # fmt: skip
"""What a figure depends on. The other files of tables/ plan, name rows and write figures down."""
SOURCES = (".py", ".cpp", ".hpp", ".h")


@cache
def code_hash(of: Literal["training", "measuring"], package: Path = PACKAGE) -> str:
    """SHA-256 over the names and bytes of the source files in TRAINING or MEASURING."""
    digest = hashlib.sha256()
    for part in TRAINING if of == "training" else MEASURING:
        place = package / part
        files = [place] if place.is_file() else sorted(place.rglob("*"))
        for path in files:
            if path.suffix in SOURCES and path.is_file():
                content = path.read_bytes()
                name = path.relative_to(package).as_posix()
                digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()
