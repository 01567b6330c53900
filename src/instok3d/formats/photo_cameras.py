"""Cameras of a scene's photos at their own size, under names that are all different."""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from instok3d.geometry.spherical_harmonics import SH_CONSTANT
from instok3d.photos.cameras import PhotoCamera
from instok3d.scene.scene import Scene


def photo_cameras(scene: Scene) -> tuple[PhotoCamera, ...]:
    """The pinhole cameras of all photos in the scene's world, in float64.

    A name is the photo's file name; of several with one name the later ones get a number in front.
    Of a photo whose file is stored turned (EXIF), they are those of the photo set upright.
    """
    cameras, taken = [], set()
    for index, view in enumerate(scene.views):
        # A space would end the name in COLMAP's text files, a line break the line.
        name = "_".join(view.file.split()) or f"view_{index:03d}"
        if name in taken:
            name = f"{index:03d}_{name}"
        taken.add(name)
        at_model = scene.cameras.intrinsics[index].detach().cpu().double()
        cameras.append(
            PhotoCamera(
                name=name,
                height=view.pixel_map.original_height,
                width=view.pixel_map.original_width,
                intrinsics=view.pixel_map.intrinsics_to_original(at_model),
                cam_from_world=scene.cameras.cam_from_world[index].detach().cpu().double(),
            )
        )
    return tuple(cameras)


def solid_points(
    scene: Scene, least_opacity: float = 0.5
) -> tuple[Float[Tensor, "point 3"], UInt8[Tensor, "point 3"]]:
    """Centres and sRGB bytes of the Gaussians that are not faint, as a sparse cloud."""
    gaussians = scene.gaussians.map(lambda tensor: tensor.detach().cpu())
    gaussians = gaussians.rows(gaussians.opacities >= least_opacity)
    colors = (0.5 + SH_CONSTANT * gaussians.sh[:, 0]).clamp(0, 1)
    return gaussians.means.double(), (colors * 255).round().to(torch.uint8)
