"""Gaussians and scenes made by hand for the tests of file formats."""

from dataclasses import replace

import torch

from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.render import render
from instok3d.scene.from_tokens import with_objects
from instok3d.scene.paths import look_at
from instok3d.scene.scene import Scene
from instok3d.types import Cameras, Gaussians
from made_scene import made_scene, made_tokens

SIDE = 96
CORNERS = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
"""In OpenCV axes about a point 4 in front of the camera."""
CORNER_COLORS = 0.15 + 0.35 * (CORNERS + 1)
"""No two alike: red grows to the right, green downwards, blue into the picture."""


def psnr(first: torch.Tensor, second: torch.Tensor) -> float:
    return float(-10 * (first - second).square().mean().clamp_min(1e-12).log10())


def camera(center: tuple[float, float, float] = (0.0, 0, 0)) -> Cameras:
    """A camera that looks at the point (0, 0, 4), image-down along +y."""
    target, down = torch.tensor([[0.0, 0, 4]]), torch.tensor([0.0, 1, 0])
    intrinsics = torch.tensor([[[SIDE * 1.0, 0, SIDE / 2], [0, SIDE * 1.0, SIDE / 2], [0, 0, 1]]])
    return Cameras(look_at(torch.tensor([center]), target, down), intrinsics)


def picture(gaussians: Gaussians, center: tuple[float, float, float] = (0.7, -0.4, 0)):
    return render(gaussians, camera(center), SIDE, SIDE).colors[0].clamp(0, 1)


def eight_corners() -> Gaussians:
    """Eight long blobs of eight colours, each turned another way; colours change with the view."""
    generator = torch.Generator().manual_seed(5)
    sh = torch.zeros(8, 4, 3)
    sh[:, 0] = (CORNER_COLORS - 0.5) / SH_CONSTANT
    sh[:, 1:] = 0.15 * torch.randn(8, 3, 3, generator=generator)
    return Gaussians(
        means=CORNERS * torch.tensor([1.0, 0.8, 0.6]) + torch.tensor([0.0, 0.0, 4.0]),
        quats=torch.nn.functional.normalize(torch.randn(8, 4, generator=generator), dim=-1),
        scales=torch.tensor([0.35, 0.12, 0.05]).expand(8, 3).contiguous(),
        opacities=torch.linspace(0.6, 0.95, 8),
        sh=sh,
        anchor_index=torch.arange(8),
    )


def corner_scene() -> Scene:
    """The eight corners, in made_scene's first five groups' stead: no objects, two views."""
    scene = made_scene(made_tokens())
    return replace(scene, gaussians=eight_corners(), objects=())


def furnished_scene(count: int = 1500, sh_count: int = 4) -> Scene:
    """A floor, a wall and two boxes of many small Gaussians, two of them objects, as rooms have."""
    generator = torch.Generator().manual_seed(6)
    part = torch.arange(count) % 4
    flat = torch.rand(count, 3, generator=generator) * 2 - 1
    size = torch.tensor([[2.0, 0.01, 1.8], [2.2, 1.6, 0.01], [0.4, 0.5, 0.4], [0.3, 0.3, 0.5]])
    place = torch.tensor([[0.0, 1.0, 4.0], [0.0, -0.4, 5.8], [-0.8, 0.5, 3.8], [0.8, 0.7, 3.6]])
    tint = torch.tensor([[0.3, -0.1, -0.6], [0.5, 0.5, 0.3], [1.0, -0.9, -0.9], [-0.9, 0.0, 1.2]])
    means = flat * size[part] + place[part]
    sh = torch.zeros(count, sh_count, 3)
    sh[:, 0] = tint[part] + 0.3 * torch.sin(5 * means) + 0.05 * flat
    sh[:, 1:] = 0.08 * torch.randn(count, sh_count - 1, 3, generator=generator)
    assignment = torch.tensor([[0.0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 1, 0]])
    scene = made_scene(made_tokens(sh_count=sh_count))
    whole = replace(
        scene,
        gaussians=Gaussians(
            means=means,
            quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1),
            scales=0.03 + 0.08 * torch.rand(count, 3, generator=generator),
            opacities=0.3 + 0.69 * torch.rand(count, generator=generator),
            sh=sh,
            anchor_index=part,
        ),
        tokens=replace(
            scene.tokens,
            positions=place,
            anchors=scene.tokens.anchors[:4],
            groups=scene.tokens.groups[:2],
            assignment=assignment,
        ),
        near_far=(0.05, 100.0),
        objects=(),
    )
    return with_objects(whole)
