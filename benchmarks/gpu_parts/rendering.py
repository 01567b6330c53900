"""gsplat on the GPU against the C++ kernels: pictures, maps and gradients.

On the CPU the kernels stand in for gsplat, and the PyTorch reference for the kernels.
"""

import time

import torch
from torch import Tensor
from torch.nn import functional

from gpu_parts.measuring import relative_error
from gpu_parts.rows import Row, Setting, at_most
from instok3d.render import render
from instok3d.types import Cameras, Gaussians, Rendering

CHANNELS = (0, 1, 3, 31, 32, 33, 64, 100)
"""Around gsplat's chunks of 32 channels, up to the paper's 100 groups."""
IMAGES_BOUND, GRADIENTS_BOUND = 2e-3, 1e-2
"""Relative errors: gsplat composites in float32 in another order and cuts alphas at 0.999 instead
of 0.99, which opacities up to 0.9 do not reach; its threshold of 1/255 cuts at other roundings."""


def build_gsplat(setting: Setting) -> list[Row]:
    """The first picture, for which gsplat compiles its kernels where that has not been done."""
    gaussians, cameras, _ = random_scene(10, 16, 0)
    start = time.perf_counter()
    out = render(gaussians.to(setting.device), cameras.to(setting.device), 16, 16)
    finite = bool(out.colors.isfinite().all())
    return [
        Row("first picture", f"{time.perf_counter() - start:.1f} s"),
        Row("its colors", "finite" if finite else "not finite", "finite", finite),
    ]


def compare_backends(setting: Setting) -> list[Row]:
    """Relative errors of all outputs and gradients, for each number of channels."""
    fast, sure = ("auto", "native") if setting.on_gpu else ("native", "reference")
    count, side = (200, 24) if setting.toy else (20_000, 256)
    rows = []
    for channels in CHANNELS[:3] if setting.toy else CHANNELS:
        found = _images_and_gradients(count, side, channels, setting.device, fast)
        expected = _images_and_gradients(count, side, channels, "cpu", sure)
        for kind, bound in (("images", IMAGES_BOUND), ("gradients", GRADIENTS_BOUND)):
            errors = {
                name: relative_error(value, expected[kind][name])
                for name, value in found[kind].items()
            }
            worst = max(errors, key=lambda name: errors[name])
            rows.append(at_most(f"{channels} channels, {kind}, most in {worst}",
                                errors[worst], bound))  # fmt: skip
    return rows


def _images_and_gradients(
    count: int, side: int, channels: int, device: str, backend: str
) -> dict[str, dict[str, Tensor]]:
    gaussians, cameras, features = random_scene(count, side, channels)
    gaussians, cameras = gaussians.to(device), cameras.to(device)
    features = None if features is None else features.to(device)
    leaves = {k: v.requires_grad_() for k, v in vars(gaussians).items() if v.is_floating_point()}
    if features is not None:
        leaves["features"] = features.requires_grad_()
    out = render(gaussians, cameras, side, side, anchor_features=features, backend=backend)  # pyright: ignore[reportArgumentType]
    images = {k: v for k, v in vars(out).items() if v is not None}
    gradients = torch.autograd.grad(_loss(out), list(leaves.values()))
    detached = {name: image.detach().cpu() for name, image in images.items()}
    return {
        "images": detached,
        "gradients": {k: v.cpu() for k, v in zip(leaves, gradients, strict=True)},
    }


def _loss(out: Rendering) -> Tensor:
    """Weighs colours, coverage and maps by fixed random numbers; depth divides by coverage."""
    generator = torch.Generator().manual_seed(1)
    images = [out.colors, out.alphas, *([] if out.features is None else [out.features])]
    weights = [torch.randn(x.shape, generator=generator).to(x.device) for x in images]
    return sum(((x * w).sum() for x, w in zip(images, weights, strict=True)), torch.tensor(0.0))


def random_scene(count: int, side: int, channels: int) -> tuple[Gaussians, Cameras, Tensor | None]:
    """Two scenes of Gaussians that fill the picture, each seen by two cameras, on the CPU."""
    generator = torch.Generator().manual_seed(0)
    anchors, scenes = 50, 2

    def normal(*shape: int) -> Tensor:
        return torch.randn(scenes, *shape, generator=generator)

    gaussians = Gaussians(
        means=normal(count, 3) * torch.tensor([0.8, 0.8, 0.5]) + torch.tensor([0.0, 0.0, 3.0]),
        quats=functional.normalize(normal(count, 4), dim=-1),
        scales=(0.3 * normal(count, 3) - 2.0).exp() * (200 / count) ** (1 / 3),
        opacities=0.9 * normal(count).sigmoid(),
        sh=0.3 * normal(count, 9, 3),
        anchor_index=torch.randint(anchors, (scenes, count), generator=generator),
    )
    cam_from_world = torch.eye(4).expand(scenes, 2, 4, 4).clone()
    cam_from_world[:, 1, 0, 3] = 0.1
    half = side / 2
    intrinsics = torch.tensor([[1.1 * side, 0, half], [0, 1.1 * side, half], [0, 0, 1]])
    cameras = Cameras(cam_from_world, intrinsics.expand(scenes, 2, 3, 3).clone())
    features = torch.rand(scenes, anchors, channels, generator=generator) if channels else None
    return gaussians, cameras, features
