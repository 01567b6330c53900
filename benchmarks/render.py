"""Times the rasterizer: processor time of one thread, medians, all variants interleaved.

The scene is the authors' (32,768 Gaussians at 256 x 256) where the folder `shared` with the data
and an older prototype stands beside the project; else a random scene of like statistics.
"""

import importlib.util
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
import tyro
from torch.nn import functional

from instok3d.render import native_backend, native_status, render
from instok3d.types import Cameras, Gaussians

PROTOTYPE = Path(__file__).resolve().parents[2] / "shared" / "prototypes" / "raster"
SH_CONSTANT = 0.28209479177387814


@dataclass(frozen=True)
class Options:
    """What to time."""

    repeats: int = 15
    """Runs of each variant; the median counts."""
    threads: bool = False
    """Also compare wall time on two threads with one; needs two idle processors."""
    reference: bool = False
    """Also time the PyTorch reference, on a small scene."""
    training: bool = True
    """Also time a training step's call: 4 scenes x 3 views, 128 px, 40 channels."""
    instruction_sets: tuple[str, ...] = ("auto",)
    """Kernels to time; see `instok3d doctor` for those of this processor."""


def main(options: Options) -> None:
    """Prints one JSON object with milliseconds."""
    torch.set_num_threads(1)
    print(native_status(), file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder:
        scene, prototype = authors_scene(Path(folder))
        results: dict[str, Any] = {"gaussians": len(scene["means"]), "scene": scene["name"]}
        for channels in (0, 100):
            variants: dict[str, Callable[[], tuple[float, float]]] = {}
            for name in options.instruction_sets:
                variants[f"ours {name}"] = our_variant(scene, channels, name)
            if prototype is not None:
                variants["prototype"] = prototype_variant(prototype, scene, channels)
            results[f"rgb + {channels} maps" if channels else "rgb"] = compare(
                variants, options.repeats
            )
        if options.training:
            variants = {f"ours {name}": training_variant(name) for name in options.instruction_sets}
            results["training call"] = compare(variants, options.repeats)
        if options.reference:
            results["2,048 gaussians, 64 x 64"] = compare(reference_variants(), 5)
        if options.threads:
            results["two threads are faster by"] = {
                f"{channels} maps": two_threads(scene, channels, options.repeats)
                for channels in (0, 100)
            }
    print(json.dumps(results, indent=2))


def compare(
    variants: dict[str, Callable[[], tuple[float, float]]], repeats: int
) -> dict[str, dict[str, float]]:
    """Median milliseconds, forward and backward, of variants that take turns."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in variants}
    for run in range(repeats + 2):
        for name, variant in variants.items():
            forward, backward = variant()
            if run >= 2:  # the first ones fetch memory and code
                times[name].append((1e3 * forward, 1e3 * backward))
    result = {}
    for name, pairs in times.items():
        forward, backward = (statistics.median(column) for column in zip(*pairs, strict=True))
        both = statistics.median(sum(pair) for pair in pairs)
        result[name] = {
            "forward": round(forward, 2), "backward": round(backward, 2), "sum": round(both, 2),
        }  # fmt: skip
    if "prototype" in result:
        for value in result.values():
            value["x prototype"] = round(value["sum"] / result["prototype"]["sum"], 3)
    return result


def timed(
    gaussians: Gaussians,
    cameras: Cameras,
    size: int,
    features: torch.Tensor | None,
    *,
    backend: Any = "native",
    clock: Callable[[], float] = time.thread_time,
) -> Callable[[], tuple[float, float]]:
    """A variant that renders and goes backward from given gradients of colours, alphas, maps."""
    leaves = [v.requires_grad_() for v in vars(gaussians).values() if v.is_floating_point()]
    if features is not None:
        leaves.append(features.requires_grad_())
    generator = torch.Generator().manual_seed(0)
    grads: list[torch.Tensor] = []

    def run() -> tuple[float, float]:
        start = clock()
        out = render(gaussians, cameras, size, size, anchor_features=features, backend=backend)
        middle = clock()
        images = [out.colors, out.alphas] + ([out.features] if out.features is not None else [])
        if not grads:
            grads.extend(torch.randn(image.shape, generator=generator) for image in images)
        before = clock()
        torch.autograd.grad(images, leaves, grads)
        return middle - start, clock() - before

    return run


def our_variant(
    scene: dict[str, Any], channels: int, name: str, clock: Callable[[], float] = time.thread_time
) -> Callable[[], tuple[float, float]]:
    """The authors' scene."""
    count, size = len(scene["means"]), scene["W"]
    gaussians = Gaussians(
        means=torch.tensor(scene["means"]),
        quats=torch.tensor(scene["quats"]),
        scales=torch.tensor(scene["scales"]),
        opacities=torch.tensor(scene["opac"]),
        sh=((torch.tensor(scene["rgb"]) - 0.5) / SH_CONSTANT).view(count, 1, 3),
        anchor_index=torch.tensor(scene["anchor"]).long(),
    )
    intrinsics = torch.tensor(
        [[scene["fx"], 0, scene["cx"]], [0, scene["fy"], scene["cy"]], [0, 0, 1]]
    )
    cameras = Cameras(torch.eye(4)[None], intrinsics.float()[None])
    features = torch.tensor(scene["pi"])[:, :channels].contiguous() if channels else None
    inner = timed(gaussians, cameras, size, features, clock=clock)

    def run() -> tuple[float, float]:
        native_backend.instruction_set = name
        return inner()

    return run


def two_threads(scene: dict[str, Any], channels: int, repeats: int) -> float:
    """Best wall time of one thread over that of two."""
    variant = our_variant(scene, channels, "auto", time.perf_counter)
    best = {1: float("inf"), 2: float("inf")}
    for _ in range(repeats + 2):
        for threads in best:
            torch.set_num_threads(threads)
            best[threads] = min(best[threads], sum(variant()))
    torch.set_num_threads(1)
    return round(best[1] / best[2], 2)


def random_gaussians(*lead: int, count: int, anchors: int, generator: torch.Generator) -> Gaussians:
    """Gaussians with the statistics of the authors': faint, some pixels wide, around anchors."""

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*lead, *shape, generator=generator)

    index = (torch.arange(count) * anchors // count).expand(*lead, count).contiguous()
    centers = normal(anchors, 3) * torch.tensor([0.8, 0.8, 0.5]) + torch.tensor([0.0, 0.0, 2.5])
    return Gaussians(
        means=centers[..., index.view(-1, count)[0], :] + 0.05 * normal(count, 3),
        quats=functional.normalize(normal(count, 4), dim=-1),
        scales=(normal(count, 3) - 3.8).exp() * (32768 / count) ** (1 / 3),
        opacities=(normal(count) * 1.5 - 2).sigmoid(),
        sh=normal(count, 1, 3) * 0.5,
        anchor_index=index,
    )


def training_variant(name: str) -> Callable[[], tuple[float, float]]:
    """One call of a training step."""
    generator = torch.Generator().manual_seed(0)
    gaussians = random_gaussians(4, count=8192, anchors=256, generator=generator)
    cameras = Cameras(torch.eye(4).expand(4, 3, 4, 4).clone(), square_intrinsics(128, 4, 3))
    features = torch.rand(4, 256, 40, generator=generator)
    inner = timed(gaussians, cameras, 128, features)

    def run() -> tuple[float, float]:
        native_backend.instruction_set = name
        return inner()

    return run


def reference_variants() -> dict[str, Callable[[], tuple[float, float]]]:
    """A scene that is small enough for the dense reference."""
    generator = torch.Generator().manual_seed(0)
    gaussians = random_gaussians(count=2048, anchors=64, generator=generator)
    cameras = Cameras(torch.eye(4)[None], square_intrinsics(64, 1))
    return {
        f"ours {backend}": timed(gaussians, cameras, 64, None, backend=backend)
        for backend in ("native", "reference")
    }


def square_intrinsics(size: int, *lead: int) -> torch.Tensor:
    """Focal length 1.1 of the width, the centre in the middle."""
    matrix = torch.tensor([[1.1 * size, 0, size / 2], [0, 1.1 * size, size / 2], [0, 0, 1]])
    return matrix.expand(*lead, 3, 3).clone()


def authors_scene(folder: Path) -> tuple[dict[str, Any], ModuleType | None]:
    """The benchmark scene as arrays, and the prototype's wrapper, built in `folder`."""
    if not PROTOTYPE.is_dir():
        print("no authors' scene and no prototype here: a random scene instead", file=sys.stderr)
        generator = torch.Generator().manual_seed(0)
        g = random_gaussians(count=32768, anchors=1024, generator=generator)
        return {
            "name": "random", "means": g.means.numpy(), "quats": g.quats.numpy(),
            "scales": g.scales.numpy(), "opac": g.opacities.numpy(),
            "rgb": (g.sh[:, 0] * SH_CONSTANT + 0.5).clamp(min=0).numpy(), "W": 256,
            "fx": 281.6, "fy": 281.6, "cx": 128, "cy": 128, "anchor": g.anchor_index.numpy(),
            "pi": torch.rand(1024, 100, generator=generator).numpy(),
        }, None  # fmt: skip
    scenes = load_module(PROTOTYPE / "scenes.py")
    scene = scenes.build(scenes.SCENES[0], K=1024, Ng=32, W=256, H=256, L=100)
    for name in ("raster2.cpp", "craster.py", "build2.sh"):
        shutil.copy(PROTOTYPE / name, folder)
    subprocess.run(["bash", "build2.sh"], cwd=folder, check=True)
    return {**scene, "name": scenes.SCENES[0]}, load_module(folder / "craster.py")


def prototype_variant(
    module: ModuleType, scene: dict[str, Any], channels: int
) -> Callable[[], tuple[float, float]]:
    """The prototype with streaming stores, the faster of its two builds."""
    library = module.load("libraster2nt.so")
    library.set_threads(1)
    rasterizer = module.Raster(library, scene)
    generator = np.random.default_rng(0)
    size = scene["W"]
    grads = [
        generator.normal(size=(count, size, size)).astype(np.float32) for count in (3, 1, channels)
    ]

    def run() -> tuple[float, float]:
        start = time.thread_time()
        rasterizer.forward(L=channels)
        middle = time.thread_time()
        rasterizer.backward(grads[0], grads[1][0], grads[2] if channels else None)
        return middle - start, time.thread_time() - middle

    return run


def load_module(path: Path) -> ModuleType:
    """A Python file as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    main(tyro.cli(Options))
