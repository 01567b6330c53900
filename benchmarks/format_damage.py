"""Reads very many damaged files of each format: no crash, no hang, no great allocation.

A reader may take at most four times the file and 64 MB more than the process has. Whatever else
than a reading or a refusal in one line happens stops the run and is shown.

    python benchmarks/format_damage.py --count 200000

The damaged file is written anew each time. On a disk that takes longer than to read it, so it lies
in memory where the system has a folder for that. Runs of other seeds damage it in other ways.
"""

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import mutations
from instok3d.formats.registry import FORMATS, ExportOptions, export_scene, read_splats
from instok3d.types import check_gaussians
from packed_mutations import INSIDE
from splat_scenes import furnished_scene

SPARE_BYTES = 64 * 2**20
MEMORY = Path("/dev/shm")


@dataclass(frozen=True)
class Options:
    """How many files."""

    count: int = 200_000
    """Of each format."""
    gaussians: int = 8
    """In the file that is damaged; its header is a larger part of a smaller one."""
    seed: int = 0
    formats: tuple[str, ...] = tuple(each.suffix for each in FORMATS if each.reader and each.writer)
    """Endings of those to be read."""
    folder: Path | None = MEMORY if MEMORY.is_dir() else None
    """Where the damaged file lies; None takes the system's folder for temporary files."""


def main(options: Options) -> None:
    """Prints a Markdown table."""
    print("| format | bytes | files | read | refused | seconds |")
    print("|---|---|---|---|---|---|")
    for each in FORMATS:
        if each.suffix not in options.formats:
            continue
        with tempfile.TemporaryDirectory(dir=options.folder) as folder:
            file = Path(folder) / f"a{each.suffix}"
            export_scene(furnished_scene(options.gaussians), file, ExportOptions(with_ids=True))
            size = file.stat().st_size
            mutations.SPARE_BYTES = 4 * size + SPARE_BYTES

            def read(file: Path = file) -> None:
                check_gaussians(read_splats(file).gaussians, file)

            start = time.perf_counter()
            damage = INSIDE.get(each.suffix, mutations.of_bytes)
            refused = mutations.survive(file, read, damage, options.count, options.seed)
            took_s = time.perf_counter() - start
        sound = options.count - len(refused)
        print(f"| {each.suffix} | {size} | {options.count} | {sound} | {len(refused)} | "
              f"{took_s:.0f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(tyro.cli(Options))
