"""How long edits of a scene of 32,768 Gaussians take, besides reading and writing files.

    python benchmarks/editing.py [--gaussians N] [--views N] [--repeats N]

The scene is made of clusters of Gaussians at random above a floor; times are medians in
milliseconds of processor time, on one thread. The goals are 20 ms for remove and move, and 1 s for
remove with claim and fill.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import torch

from instok3d.photos.pixel_map import fit_pixels
from instok3d.scene.from_gaussians import scene_from_gaussians
from instok3d.scene.paths import orbit
from instok3d.scene.record import Provenance, SceneView
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians

OBJECTS, SIDE, REMOVED = 40, 128, 7


def made_scene(count: int, num_views: int) -> Scene:
    """A scene of OBJECTS clusters, one row of anchors for each 32 Gaussians, views around it."""
    generator = torch.Generator().manual_seed(0)
    ids = torch.arange(count) * OBJECTS // count + 1
    centers = 4 * torch.rand(OBJECTS + 1, 3, generator=generator)
    centers[REMOVED] = torch.tensor([2.0, 4.2, 2.0])
    means = centers[ids] + 0.2 * torch.randn(count, 3, generator=generator)
    quats = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1)
    scales = 0.01 + 0.04 * torch.rand(count, 3, generator=generator)
    opacities = torch.rand(count, generator=generator)
    # A floor with a hole below the removed object, to be filled.
    floor, place = (
        slice(count - count // 8, count),
        8 * torch.rand(count // 8, 2, generator=generator) - 2,
    )
    place[(place - 2).norm(dim=1) < 0.8] = torch.tensor([-2.0, -2.0])
    means[floor] = torch.stack([place[:, 0], torch.full_like(place[:, 0], 4.5), place[:, 1]], dim=1)
    quats[floor], scales[floor] = torch.tensor([1.0, 0, 0, 0]), torch.tensor([0.2, 0.01, 0.2])
    opacities[floor], ids[floor] = 0.95, OBJECTS
    gaussians = Gaussians(
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        sh=torch.randn(count, 9, 3, generator=generator),
        anchor_index=torch.zeros(count, dtype=torch.long),
    )
    made = Provenance("benchmark", "none", "", seed=0)
    scene = scene_from_gaussians(gaussians, ids, provenance=made, height=SIDE, width=SIDE)
    views = tuple(
        SceneView(f"{index}.jpg", "0" * 64, fit_pixels(SIDE, SIDE, SIDE, SIDE))
        for index in range(num_views)
    )
    photos = torch.zeros(num_views, SIDE, SIDE, 3, dtype=torch.uint8)
    return replace(scene, cameras=orbit(scene, num_views), views=views, photos=photos)


def median_ms(function: Callable[[], object], repeats: int) -> float:
    """Processor time of some calls, after one to warm up."""
    function()
    times_s = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times_s.append(time.process_time() - start)
    return 1000 * statistics.median(times_s)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--gaussians", type=int, default=32_768)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    torch.set_num_threads(1)
    fresh = made_scene(options.gaussians, options.views)
    scene = fresh.hide(1)  # as a scene that was loaded: its source's hash is known
    jobs: dict[str, Callable[[], object]] = {
        "remove": lambda: scene.remove(REMOVED),
        "remove, first edit of a new scene": lambda: fresh.remove(REMOVED),
        "move": lambda: scene.move(7, (0.1, 0, 0)),
        "move, turned and scaled": lambda: scene.move(7, (0.1, 0, 0), yaw=30, scale=1.1),
        "duplicate": lambda: scene.duplicate(7, (0.1, 0, 0)),
        "insert": lambda: scene.insert(scene, 7, (0, 0, 0)),
        "recolor": lambda: scene.recolor(7, "red"),
        "merge": lambda: scene.merge(7, 8),
        "hide": lambda: scene.hide(7),
        "undo of one of two edits": lambda: scene.remove(REMOVED).undo(),
        f"remove with claim, {options.views} views": lambda: scene.remove(REMOVED, claim=True),
        f"remove with claim and fill, {options.views} views": lambda: scene.remove(
            REMOVED, claim=True, fill="plane"
        ),
        f"where objects are seen, {options.views} views": lambda: (
            scene.remove(REMOVED).object(8).visible_in
        ),
    }
    print(f"{options.gaussians:,} Gaussians")
    for name, job in jobs.items():
        print(f"{name:40} {median_ms(job, options.repeats):9.1f} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
