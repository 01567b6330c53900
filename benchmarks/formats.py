"""What each format loses of a scene: sizes, and pictures read back against the scene's own.

    python benchmarks/formats.py demo.itk

Without a scene, of the demo, which is made.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import torch
import tyro

import instok3d
from instok3d.formats.registry import FORMATS, export_scene, read_splats
from instok3d.scene.paths import orbit
from instok3d.scene.scene import Scene

FRAMES = 6


def main(scene: Annotated[Path | None, tyro.conf.Positional] = None) -> None:
    """Prints a Markdown table; the dB are over an orbit near the inputs."""
    loaded = instok3d.demo() if scene is None else instok3d.load(scene)
    wanted = pictures(loaded)
    print("| format | bytes a Gaussian | dB |")
    print("|---|---|---|")
    for each in FORMATS:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"scene{each.suffix}"
            export_scene(loaded, file)
            size = file.stat().st_size / len(loaded.gaussians.means)
            db = "-"
            if each.reader:
                again = replace(loaded, gaussians=read_splats(file).gaussians, objects=())
                error = (pictures(again) - wanted).square().mean()
                db = f"{float(-10 * error.clamp_min(1e-12).log10()):.1f}"
        print(f"| {each.suffix} | {size:.1f} | {db} |", flush=True)


def pictures(scene: Scene) -> torch.Tensor:
    """The scene from an orbit."""
    return scene.render(orbit(scene, FRAMES)).colors.clamp(0, 1)


if __name__ == "__main__":
    tyro.cli(main)
