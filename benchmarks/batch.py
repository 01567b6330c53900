"""Scenes a minute: `instok3d batch` against `instok3d reconstruct` for each, of the same photos.

    python benchmarks/batch.py --data rooms-test [--scenes 8] [--workers 1] [--refine STEPS]

Photos 2 and 4 of each scene. Both ways are run as people run them, one after the other, and make
the same objects. The processor time of all their processes is measured beside the clock, which
other work on the machine changes.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from instok3d.rooms.dataset import RoomDataset

FRAMES = (2, 4)


def write_photos(data: RoomDataset, count: int, folder: Path) -> list[Path]:
    """A folder of photos for each scene."""
    places = []
    for number in range(count):
        place = folder / f"room{number:02d}"
        place.mkdir(parents=True)
        for index, image in enumerate(data.frames(number, FRAMES).images):
            Image.fromarray(image.numpy()).save(place / f"{index}.png")
        places.append(place)
    return places


def spent(commands: list[list[str]]) -> tuple[float, float]:
    """Seconds of the processor and of the clock."""
    used, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    for words in commands:
        subprocess.run(
            [sys.executable, "-m", "instok3d", *words], check=True, stdout=subprocess.DEVNULL
        )
    clock = time.perf_counter() - begin
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime, clock


def objects_of(scene: Path) -> int:
    """How many objects a scene has."""
    return len(json.loads((scene / "objects.json").read_text())["objects"])


def main() -> None:
    """Print both ways, and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--refine", type=int)
    given = parser.parse_args()
    more = [] if given.refine is None else ["--refine", str(given.refine)]
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        places = write_photos(RoomDataset(given.data), given.scenes, base / "photos")
        batch = ["batch", str(base / "photos"), "-o", str(base / "many"), *more]
        ways = {
            "reconstruct, each": [
                ["reconstruct", str(place), "-o", str(base / f"{place.name}.itk"), *more]
                for place in places
            ],
            "batch": [[*batch, "--workers", str(given.workers)]],
        }
        times = {name: spent(commands) for name, commands in ways.items()}
        for place in places:
            alone, made = (objects_of(each / f"{place.name}.itk") for each in (base, base / "many"))
            if alone != made:
                raise ValueError(f"{place.name} has {alone} objects alone and {made} in the batch")
    for name, (processor_s, clock_s) in times.items():
        print(
            f"{name:18} {60 * given.scenes / processor_s:6.2f} scenes a minute of the processor, "
            f"{60 * given.scenes / clock_s:6.2f} of the clock"
        )
    alone, made = times["reconstruct, each"], times["batch"]
    print(f"batch takes {made[0] / alone[0]:.2f} of the processor time, {made[1] / alone[1]:.2f} "
          "of the time")  # fmt: skip


if __name__ == "__main__":
    main()
