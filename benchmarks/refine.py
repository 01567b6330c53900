"""Times refinement: steps a second at 2, 8 and 16 views, and what a step consists of.

Times are of the demo's scene at the size its model sees; views beyond eight are repeated.

    python benchmarks/refine.py

Nothing else running.
"""

import time
from dataclasses import dataclass

import torch
import tyro

import instok3d
from instok3d.refinement.optimization import refine_gaussians
from instok3d.refinement.settings import RefinementSettings
from instok3d.render import render
from instok3d.scene.demo import demo_photos


@dataclass(frozen=True)
class Options:
    """What to time."""

    threads: int = 2
    steps: int = 100
    views: tuple[int, ...] = (2, 8, 16)
    """Numbers of views."""


def main(options: Options) -> None:
    """Prints a Markdown table."""
    torch.set_num_threads(options.threads)
    with demo_photos() as folder:
        scene = instok3d.reconstruct(folder, refine=0)
    images = scene.photos.permute(0, 3, 1, 2).float() / 255
    near, far = scene.near_far
    print("| views | Gaussians | steps a second | all steps | two renders of the views of a step |")
    print("|---|---|---|---|---|")
    for count in options.views:
        which = [view % len(images) for view in range(count)]
        cameras, photos = scene.cameras.views(which), images[which]
        settings = RefinementSettings(steps=options.steps)
        refine_gaussians(  # the first call allocates
            scene.gaussians, cameras, photos, RefinementSettings(steps=3), near=near, far=far
        )
        start = time.perf_counter()
        refine_gaussians(scene.gaussians, cameras, photos, settings, near=near, far=far)
        took_s = time.perf_counter() - start
        seen = cameras.views(list(range(min(count, settings.views_per_step))))
        start = time.perf_counter()
        for _ in range(2 * options.steps):
            render(scene.gaussians, seen, scene.height, scene.width, near=near, far=far)
        renders = (time.perf_counter() - start) / took_s
        print(
            f"| {count} | {len(scene.gaussians.means)} | {options.steps / took_s:.1f} | "
            f"{took_s:.2f} s | {renders:.0%} of that |"
        )


if __name__ == "__main__":
    main(tyro.cli(Options))
