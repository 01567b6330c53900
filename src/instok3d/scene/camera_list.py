"""cameras.json of a scene folder: a list, one entry a view."""

import dataclasses
from pathlib import Path
from typing import Any

import torch

from instok3d.geometry.camera_json import read_intrinsics, read_pose
from instok3d.geometry.cameras import invert_rigid
from instok3d.photos.pixel_map import PixelMap
from instok3d.reading import naming_damage, number, text, whole_number
from instok3d.scene.header import REMEDY
from instok3d.scene.object_list import read_entries
from instok3d.scene.record import SceneRecord, SceneView
from instok3d.types import Cameras

MAX_VIEWS = 10_000
"""More are taken for damage before anything is allocated, as are views that are too large."""


def cameras_document(scene: SceneRecord) -> list[dict[str, Any]]:
    """What cameras.json says of a scene."""
    cam_from_world = scene.cameras.cam_from_world.detach().cpu()
    world_from_cam = invert_rigid(cam_from_world)
    return [
        {
            "file": view.file,
            "sha256": view.sha256,
            "height": scene.height,
            "width": scene.width,
            "intrinsics": scene.cameras.intrinsics[index].tolist(),
            "cam_from_world": cam_from_world[index].tolist(),
            "world_from_cam": world_from_cam[index].tolist(),
            "photo_intrinsics": view.pixel_map.intrinsics_to_original(
                scene.cameras.intrinsics[index].double().cpu()
            ).tolist(),
            "pixel_map": dataclasses.asdict(view.pixel_map),
        }
        for index, view in enumerate(scene.views)
    ]


def read_cameras(
    file: Path, frame: str, height: int, width: int
) -> tuple[Cameras, tuple[SceneView, ...]]:
    """The cameras and views that a cameras.json lists; only an imported scene may have none.

    Args:
        file: cameras.json.
        frame: `frame` of the scene; "file" is that of an imported one.
        height: Of every view, pixels.
        width: Likewise.

    Raises:
        FileNotFoundError: The file is missing.
        ValueError: It is damaged, or of other sizes; the sentence names the view.
    """
    entries = read_entries(file, REMEDY)
    least = 0 if frame == "file" else 1
    if not least <= len(entries) <= MAX_VIEWS:
        raise ValueError(f"{file}: wanted a list of {least} to {MAX_VIEWS} views")
    poses, intrinsics = [torch.zeros(0, 4, 4)], [torch.zeros(0, 3, 3)]
    views = []
    for index, entry in enumerate(entries):
        where = f"{file}: view {index}"
        with naming_damage(where, REMEDY):
            if (entry["height"], entry["width"]) != (height, width):
                raise ValueError(f"its size is not that of scene.json, {height} x {width}")
            pixel_map = _pixel_map(entry["pixel_map"], height, width)
            views.append(SceneView(text(entry["file"]), text(entry["sha256"]), pixel_map))
            poses.append(read_pose(entry["cam_from_world"], where=where).float()[None])
            intrinsics.append(
                read_intrinsics(
                    entry["intrinsics"], where=where, height=height, width=width
                ).float()[None]
            )
    return Cameras(torch.cat(poses), torch.cat(intrinsics)), tuple(views)


def _pixel_map(value: dict[str, Any], height: int, width: int) -> PixelMap:
    pixel_map = PixelMap(
        original_height=whole_number(value["original_height"], 1),
        original_width=whole_number(value["original_width"], 1),
        exif_orientation=whole_number(value["exif_orientation"], 1, 8),
        height=whole_number(value["height"], 1),
        width=whole_number(value["width"], 1),
        scale_x=number(value["scale_x"]),
        scale_y=number(value["scale_y"]),
        offset_x=number(value["offset_x"]),
        offset_y=number(value["offset_y"]),
    )
    if (pixel_map.height, pixel_map.width) != (height, width):
        raise ValueError(f"its pixel_map is not to pictures of {height} x {width}")
    if min(pixel_map.scale_x, pixel_map.scale_y) <= 0:
        raise ValueError("its pixel_map has a scale that is not above 0")
    return pixel_map
