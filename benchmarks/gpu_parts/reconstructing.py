"""`reconstruct --device cuda` against the CPU: the demo's photos, cameras, depth, pictures, ids."""

import time
import warnings
from importlib.resources import files
from pathlib import Path

import torch

from gpu_parts.rows import Row, Setting, at_least, at_most
from instok3d import Scene, reconstruct
from instok3d.evaluation.image_quality import psnr
from instok3d.render import render


def compare_devices(setting: Setting) -> list[Row]:
    """How far the two scenes are apart, and how long each took."""
    photos = Path(str(files("instok3d") / "assets" / "demo"))
    views = 2 if setting.toy else 8
    scenes, seconds = [], []
    for device in ("cpu", setting.device):
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*results on real photos are poor")
            scenes.append(reconstruct(photos, max_views=views, device=device))
        seconds.append(time.perf_counter() - start)
    rows = [
        Row("time on the CPU, with loading", f"{seconds[0]:.1f} s"),
        Row(f"time on {setting.device}, with loading", f"{seconds[1]:.1f} s"),
        *_differences(*scenes),
    ]
    return rows + (_rendered_there(scenes[0], setting) if setting.on_gpu else [])


def _differences(first: Scene, second: Scene) -> list[Row]:
    # Both in float32, with other orders of summation; solving for cameras and choosing anchors
    # amplify that, so the bounds are those of a scene that looks the same.
    a, b = first.cameras.cam_from_world.double(), second.cameras.cam_from_world.double()
    turn = a[:, :3, :3].mT @ b[:, :3, :3]
    cosine = ((turn.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2).clamp(-1, 1)
    length = a[:, :3, 3].norm(dim=1).max().clamp_min(1e-9)
    shown, seen = first.render(ids=True), second.render(ids=True)
    both = (shown.depths > 0) & (seen.depths > 0)
    depth_change = (seen.depths[both] / shown.depths[both] - 1).abs()
    assert shown.ids is not None
    assert seen.ids is not None
    return [
        at_most("rotation between the cameras, deg", float(cosine.acos().rad2deg().max()), 0.5),
        at_most("distance between the cameras, of the longest",
                float((a - b)[:, :3, 3].norm(dim=1).max() / length), 0.05),
        at_most("median change of depth", float(depth_change.median()), 0.02),
        at_least("pictures of one as seen by the other, PSNR",
                 float(psnr(seen.colors[None].clamp(0, 1), shown.colors[None].clamp(0, 1)).min()),
                 28.0),
        at_least("pixels with the same object", float((shown.ids == seen.ids).float().mean()), 0.9),
        Row("objects", f"{len(second.objects)}", f"about {len(first.objects)}"),
    ]  # fmt: skip


def _rendered_there(scene: Scene, setting: Setting) -> list[Row]:
    """The CPU's scene drawn by gsplat."""
    near, far = scene.near_far
    size = (scene.height, scene.width)
    here = render(scene.gaussians, scene.cameras, *size, near=near, far=far)
    gaussians, cameras = scene.gaussians.to(setting.device), scene.cameras.to(setting.device)
    with torch.no_grad():
        there = render(gaussians, cameras, *size, near=near, far=far).to("cpu")
    quality = psnr(there.colors[None].clamp(0, 1), here.colors[None].clamp(0, 1)).min()
    return [at_least("one scene drawn by gsplat and by the kernels, PSNR", float(quality), 35.0)]
