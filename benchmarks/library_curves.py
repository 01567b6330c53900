"""A library as it grows: building it, its bytes, how long questions take, and what is found.

    python benchmarks/library_curves.py [--objects 10000 100000 1000000] [--ways folder hnsw milvus]
        [--channels 384] [--questions 200] [--folder FOLDER] [--plot FILE.png]

Objects are drawn around 150 classes, scenes have 100 of them, thumbnails 2,000 bytes. The truth is
what is nearest by the vectors as they came, in double precision; recall is of its first ten.
`folder` is the library; `hnsw` is usearch's graph of the same vectors in memory (`pip install
usearch`); `milvus` is Milvus Lite by the library's own way to a server. Questions are asked on one
thread, and their times are of this process's processor, which other work hardly changes; Milvus
Lite is a process of its own, and its times are by the clock.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from panels import Panel, draw_panels

from instok3d.library.entries import Encoder, Entry, SceneEntries, SceneLibrary
from instok3d.library.folder import FolderLibrary

CLASSES, SPREAD = 150, 1.0
"""How many, and how far objects of a class lie from its middle, in lengths of the middle."""
OF_A_SCENE, THUMBNAIL_BYTES, WANTED = 100, 2000, 10
BOX = np.array([[0, 0, 0], [1, 1, 1]], np.float32)


def vectors(count: int, channels: int, seed: int) -> np.ndarray:
    """Unit vectors around the middles of classes, which do not depend on the seed."""
    middles = np.random.default_rng(0).standard_normal((CLASSES, channels), np.float32)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    rng = np.random.default_rng(seed)
    found = rng.standard_normal((count, channels), np.float32) * (SPREAD / channels**0.5)
    found += middles[rng.integers(CLASSES, size=count)]
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def scene_rows(count: int, channels: int, scene: int) -> np.ndarray:
    """The objects of one scene of a library of so many."""
    return vectors(min(OF_A_SCENE, count - scene * OF_A_SCENE), channels, scene + 1)


def truth(count: int, questions: np.ndarray) -> list[list[tuple[int, int]]]:
    """Scene and id of the nearest objects of each question, nearest first."""
    best, known = np.zeros((len(questions), 0)), np.zeros((len(questions), 0), int)
    scenes = range(-(-count // OF_A_SCENE))
    for first in range(0, len(scenes), 100):
        rows = np.concatenate([
            scene_rows(count, questions.shape[1], scene) for scene in scenes[first : first + 100]
        ])  # fmt: skip
        scores = np.concatenate([best, questions @ rows.T.astype(np.float64)], axis=1)
        names = np.arange(len(rows)) + first * OF_A_SCENE
        names = np.concatenate([known, np.broadcast_to(names, (len(questions), len(rows)))], axis=1)
        order = np.argsort(-scores, axis=1, kind="stable")[:, :WANTED]
        best, known = (np.take_along_axis(each, order, axis=1) for each in (scores, names))
    return [[named(int(number)) for number in row] for row in known]


def named(number: int) -> tuple[int, int]:
    """Scene and id of the object that was drawn as this one."""
    return number // OF_A_SCENE, number % OF_A_SCENE + 1


def fill(library: SceneLibrary, count: int, channels: int, clock: Callable[[], float]) -> float:
    """Add scene after scene, as `instok3d library add` does; the seconds that took."""
    rng = np.random.default_rng(7)
    spent = 0.0
    for scene in range(-(-count // OF_A_SCENE)):
        rows = scene_rows(count, channels, scene)
        entries = [
            Entry(each + 1, f"chair#{each + 1}", "chair", BOX, rng.bytes(THUMBNAIL_BYTES))
            for each in range(len(rows))
        ]
        added = SceneEntries(Encoder("drawn", channels), entries, rows)
        begin = clock()
        library.add(f"/rooms/{scene}.itk", added)
        spent += clock() - begin
    return spent


def measured(
    ask: Callable[[np.ndarray], list[tuple[int, int]]],
    questions: np.ndarray,
    right: list[list[tuple[int, int]]],
    clock: Callable[[], float],
) -> dict[str, float]:
    """Times of questions, and the share of the truth that is found."""
    times, shares = [], []
    ask(questions[0])
    for question, wanted in zip(questions, right, strict=True):
        begin = clock()
        found = ask(question)
        times.append(1e3 * (clock() - begin))
        shares.append(len(set(found) & set(wanted)) / len(wanted))
    p50, p99 = np.percentile(times, [50, 99])
    return {"p50_ms": p50, "p99_ms": p99, "recall": float(np.mean(shares))}


def asking(library: SceneLibrary) -> Callable[[np.ndarray], list[tuple[int, int]]]:
    """Scene and id of what a library finds."""
    return lambda question: [
        (int(Path(each.scene).stem), each.object.id) for each in library.query(question, WANTED)
    ]


def by_folder(place: Path, count: int, questions: np.ndarray, right: list) -> dict[str, float]:
    """The library in a folder."""
    made = FolderLibrary.create(place / "lib")
    built = fill(made, count, questions.shape[1], time.process_time)
    library = FolderLibrary(place / "lib")
    size = sum(each.stat().st_size for each in (place / "lib").rglob("*") if each.is_file())
    found = measured(asking(library), questions, right, time.process_time)
    return {"build_s": built, "bytes": size, **found}


def by_hnsw(place: Path, count: int, questions: np.ndarray, right: list) -> dict[str, float]:
    """A graph by usearch with its own defaults, in float16; it holds no thumbnails."""
    from usearch.index import Index  # pyright: ignore[reportMissingImports]

    index = Index(ndim=questions.shape[1], metric="ip", dtype="f16")
    built = 0.0
    for scene in range(-(-count // OF_A_SCENE)):
        rows = scene_rows(count, questions.shape[1], scene).astype(np.float16)
        begin = time.process_time()
        index.add(np.arange(len(rows)) + scene * OF_A_SCENE, rows, threads=1)
        built += time.process_time() - begin
    index.save(place / "graph")

    def ask(question: np.ndarray) -> list[tuple[int, int]]:
        keys = index.search(question.astype(np.float16), WANTED, threads=1).keys
        return [named(int(key)) for key in keys]

    found = measured(ask, questions, right, time.process_time)
    return {"build_s": built, "bytes": (place / "graph").stat().st_size, **found}


def by_milvus(place: Path, count: int, questions: np.ndarray, right: list) -> dict[str, float]:
    """Milvus Lite, as a library on a server is asked."""
    from pymilvus import MilvusClient

    from instok3d.library.milvus import MilvusLibrary

    client = MilvusClient(str(place / "lite.db"))
    made = MilvusLibrary(client, "rooms", "milvus://lite/rooms")
    built = fill(made, count, questions.shape[1], time.perf_counter)
    library = MilvusLibrary(client, "rooms", "milvus://lite/rooms")
    found = measured(asking(library), questions, right, time.perf_counter)
    size = sum(each.stat().st_size for each in place.rglob("*") if each.is_file())
    client.close()
    return {"build_s": built, "bytes": size, **found}


WAYS = {"folder": by_folder, "hnsw": by_hnsw, "milvus": by_milvus}


def plot(rows: list[dict], file: Path) -> None:
    """A panel for each figure over the number of objects."""
    ways = [way for way in WAYS if any(row["way"] == way for row in rows)]
    curves = {way: [row for row in rows if row["way"] == way] for way in ways}
    sizes = [Panel(name) for name in ("p50_ms", "p99_ms", "bytes", "build_s")]
    draw_panels(curves, "objects", [*sizes, Panel("recall", (0, 1))], file)


def main() -> None:
    """Print a JSON object for each size and way, as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), default=["folder"])
    parser.add_argument("--channels", type=int, default=384)
    parser.add_argument("--questions", type=int, default=200)
    parser.add_argument("--folder", type=Path, help="where libraries are made; a temporary one")
    parser.add_argument("--plot", type=Path, help="a PNG of what was measured")
    parser.add_argument("--known", type=Path, nargs="+", help="printed before; only plotted again")
    given = parser.parse_args()
    torch.set_num_threads(1)
    known = [each.read_text().splitlines() for each in given.known or ()]
    rows = [json.loads(line) for lines in known for line in lines]
    for count in [] if known else given.objects:
        questions = vectors(given.questions, given.channels, 10**9).astype(np.float64)
        right = truth(count, questions)
        for way in given.ways:
            with tempfile.TemporaryDirectory(dir=given.folder) as place:
                found = WAYS[way](Path(place), count, questions, right)
            rows.append({"way": way, "objects": count, **found})
            print(json.dumps(rows[-1]), flush=True)
    if given.plot is not None:
        plot(rows, given.plot)


if __name__ == "__main__":
    main()
