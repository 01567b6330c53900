"""Objects as JSON in the shape of ROS's vision_msgs/Detection3DArray, axes of REP-103."""

import warnings
from pathlib import Path
from typing import Any

import torch

from instok3d.files import json_text, replacing
from instok3d.formats.statements import scene_comments
from instok3d.formats.upright import y_up
from instok3d.geometry.rotations import matrix_to_quat, quat_multiply
from instok3d.scene.scene import Scene

FRAME = "instok3d_world"
FLU_FROM_Y_UP = torch.tensor([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""x forward, y left, z up, from x right, y up, z backward."""


def write_ros(path: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write one detection for each object: its oriented box, label and confidence.

    The world is turned so that x points forward (where the first camera of an OpenCV world looks),
    y left and z up. ROS wants metres: where the scene's units are arbitrary, a warning says so.

    Raises:
        FileExistsError: A file is there, and overwrite is off.
    """
    if scene.units != "metres":
        warnings.warn(
            "ROS takes lengths for metres, and this scene's units are arbitrary: give cameras or "
            "depth in metres, or scale the boxes",
            stacklevel=2,
        )
    turn = FLU_FROM_Y_UP @ y_up(scene.vertical)
    turn_quat = matrix_to_quat(turn)
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": FRAME}
    detections: list[dict[str, Any]] = []
    for item in scene.objects:
        center = (turn @ torch.tensor(item.obb.center)).tolist()
        quat = quat_multiply(turn_quat, torch.tensor(item.obb.quat_wxyz)).tolist()
        pose = {
            "position": dict(zip("xyz", center, strict=True)),
            "orientation": dict(zip("wxyz", quat, strict=True)),
        }
        hypothesis = {"class_id": item.label or "object", "score": item.confidence}
        covariance = {"pose": pose, "covariance": [0.0] * 36}
        detections.append(
            {
                "header": header,
                "id": str(item.id),
                "results": [{"hypothesis": hypothesis, "pose": covariance}],
                "bbox": {"center": pose, "size": dict(zip("xyz", item.obb.size, strict=True))},
            }
        )
    value = {
        "header": header,
        "detections": detections,
        "instok3d": {
            "about": list(scene_comments(scene)),
            "units": scene.units,
            "flu_from_world": turn.tolist(),
        },
    }
    with replacing(path, overwrite=overwrite) as part:
        part.write_text(json_text(value) + "\n", encoding="utf-8")
