"""Cameras as nerfstudio's transforms.json, in the scene's own world."""

from pathlib import Path
from typing import Any

import torch

from instok3d.files import json_text, replacing
from instok3d.formats.layouts import check_views
from instok3d.formats.photo_cameras import photo_cameras
from instok3d.formats.statements import scene_comments
from instok3d.geometry.cameras import invert_rigid
from instok3d.scene.scene import Scene

OPENGL_FROM_OPENCV = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))


def write_nerfstudio(path: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write transforms.json: world_from_cam with OpenGL cameras, sizes of the upright photos.

    The photos are named as images/NAME. The world is the scene's: nothing is centred or scaled.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
        ValueError: The scene has no views.
    """
    check_views(scene, "transforms.json")
    frames: list[dict[str, Any]] = []
    for camera in photo_cameras(scene):
        k = camera.intrinsics.tolist()
        world_from_cam = invert_rigid(camera.cam_from_world) @ OPENGL_FROM_OPENCV
        frames.append(
            {
                "file_path": f"images/{camera.name}",
                "w": camera.width,
                "h": camera.height,
                "fl_x": k[0][0],
                "fl_y": k[1][1],
                "cx": k[0][2],
                "cy": k[1][2],
                "transform_matrix": world_from_cam.tolist(),
            }
        )
    value = {
        "camera_model": "OPENCV",
        "orientation_override": "none",
        "about": list(scene_comments(scene)),
        "frames": frames,
    }
    with replacing(path, overwrite=overwrite) as part:
        part.write_text(json_text(value) + "\n", encoding="utf-8")
