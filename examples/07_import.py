"""Gaussians that another program made, as a scene that can be drawn and edited.

python examples/07_import.py FILE imported.itk

FILE is a .ply, .spz, .splat, .ksplat, .sog or .glb, or a folder with a PLY for each object such
as the paper's authors publish.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from instok3d.formats.importing import import_scene
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.pictures import color_picture, id_picture
from instok3d.types import Cameras

if len(sys.argv) != 3:
    sys.exit((__doc__ or "").strip())
source, output = Path(sys.argv[1]), Path(sys.argv[2])
scene = import_scene(source)
scene.save(output, overwrite=True)
for item in scene.objects:
    print(f"{item.key}: {item.num_gaussians} Gaussians")

# From the world's origin along z, where what was made of photos has its first camera.
intrinsics = intrinsics_from_field_of_view(torch.tensor(1.0), scene.height, scene.width)
camera = Cameras(torch.eye(4)[None], intrinsics[None])
pictures = scene.render(camera, ids=True)
panels = [color_picture(pictures.colors[0]), id_picture(pictures.ids[0])]
if scene.objects:
    largest = max(scene.objects, key=lambda item: item.num_gaussians)
    panels.append(color_picture(scene.remove(largest.id).render(camera).colors[0]))
Image.fromarray(np.concatenate(panels, axis=1)).save(output.with_suffix(".png"))
