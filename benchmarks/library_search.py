"""Exact search of a library against other ways through the same rows, side by side.

    python benchmarks/library_search.py [ROWS] [CHANNELS] [ROUNDS]

Times on a machine that does other things too mean little: look at the ratios, which are taken
from rounds in turn. usearch (`pip install usearch`) is measured where it is there.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch

from instok3d.library.native_search import kernel
from instok3d.library.search import in_blocks, nearest


def rows_on_disk(path: Path, rows: int, channels: int) -> np.ndarray:
    """Random unit rows in float16, mapped as those of a library are."""
    rng = np.random.default_rng(0)
    values = np.memmap(path, np.float16, "w+", shape=(rows, channels))
    for place in range(0, rows, 50_000):
        part = rng.standard_normal((min(50_000, rows - place), channels), dtype=np.float32)
        values[place : place + 50_000] = part / np.linalg.norm(part, axis=1, keepdims=True)
    values.flush()
    return np.memmap(path, np.float16, "r", shape=(rows, channels))


def ways(values: np.ndarray, query: np.ndarray) -> dict[str, Callable[[], object]]:
    """Each finds the ten nearest rows."""
    scores = np.empty(len(values), np.float32)

    def by_numpy() -> object:
        for place in range(0, len(values), 8192):
            scores[place : place + 8192] = values[place : place + 8192].astype(np.float32) @ query
        return np.argpartition(-scores, 10)[:10]

    found = {
        "library": lambda: nearest(values, query, 10),
        "library, PyTorch": lambda: np.argpartition(-in_blocks(values, query, scores), 10)[:10],
        "numpy": by_numpy,
    }
    if find_spec("usearch") is not None:
        from usearch.index import MetricKind, search  # pyright: ignore[reportMissingImports]

        half, threads = query.astype(np.float16), torch.get_num_threads()
        found["usearch, exact"] = lambda: search(
            np.asarray(values), half, 10, MetricKind.IP, exact=True, threads=threads
        )
    return found


def main() -> None:
    """Print the median time of each way and its ratio to the library's."""
    given = [int(each) for each in sys.argv[1:]]
    rows, channels, rounds = given + [1_000_000, 384, 15][len(given) :]
    with tempfile.TemporaryDirectory() as folder:
        values = rows_on_disk(Path(folder) / "rows", rows, channels)
        query = np.array(values[rows // 2], np.float32)
        measured = ways(values, query)
        times: dict[str, list[float]] = {name: [] for name in measured}
        for _ in range(rounds + 1):
            for name, run in measured.items():
                begin = time.perf_counter()
                run()
                times[name].append(time.perf_counter() - begin)
    print(
        f"{rows} x {channels}, {torch.get_num_threads()} threads, "
        f"kernel {kernel.kernels()[0] if kernel else 'not built'}"
    )
    medians = {name: float(np.median(each[1:])) for name, each in times.items()}
    for name, median in medians.items():
        print(f"{name:18} {1e3 * median:8.1f} ms  {median / medians['library']:6.2f}")


if __name__ == "__main__":
    main()
