"""A scene seen from between its first two cameras, and which object each pixel shows.

python examples/01_render.py [room.itk between.png]

Without arguments: of demo.itk, which is made if it is not there.
"""

import sys

import numpy as np
import torch
from PIL import Image

import instok3d
from instok3d.types import Cameras

given = len(sys.argv) > 1
scene = instok3d.load(sys.argv[1]) if given else instok3d.demo(progress=print)
output = sys.argv[2] if given else "between.png"
first = scene.cameras.cam_from_world[0]
second = scene.cameras.cam_from_world[min(1, len(scene.views) - 1)]
between = first.clone()
between[:3, 3] = (first[:3, 3] + second[:3, 3]) / 2
pictures = scene.render(Cameras(between[None], scene.cameras.intrinsics[:1]), ids=True)

picture = (pictures.colors[0].clamp(0, 1) * 255).round().to(torch.uint8)
Image.fromarray(np.ascontiguousarray(picture.permute(1, 2, 0).numpy())).save(output)
for item in scene.objects:
    print(f"{item.key}: {int((pictures.ids == item.id).sum())} pixels")
