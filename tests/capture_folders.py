"""Capture folders of the flat room: photos, depth and cameras as scanners leave them."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from flat_rooms import SIZE, flat_room
from instok3d.files import sha256_of


def write_capture(folder: Path, count: int, *, depth: bool = True) -> Path:
    """A scene.json with so many frames of the flat room; without depth in a transforms.json."""
    room = flat_room()
    (folder / "color").mkdir(parents=True)
    (folder / "depth").mkdir()
    frames = []
    for number in range(count):
        name = f"{number}.png"  # 10 comes after 9 in natural order alone
        Image.fromarray(room.images[number]).save(folder / "color" / name)
        millimetres = (room.depths_m[number] * 1000).round().astype(np.uint16)
        Image.fromarray(millimetres).save(folder / "depth" / name)
        pose = room.world_from_cam[number]
        frames.append({"id": str(number), "color": f"color/{name}", "depth": f"depth/{name}",
                       "c2w": pose.tolist()})  # fmt: skip
    k = room.intrinsics[0]
    if depth:
        value = {"width": SIZE, "height": SIZE, "K": k.tolist(), "depth_scale": 1000,
                 "frames": frames}  # fmt: skip
        (folder / "scene.json").write_text(json.dumps(value))
    else:
        flip = np.diag([1, -1, -1, 1.0])  # to the axes of OpenGL
        value = {
            "w": SIZE, "h": SIZE, "fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2],
            "frames": [{"file_path": frame["color"],
                        "transform_matrix": (np.array(frame["c2w"]) @ flip).tolist()}
                       for frame in frames],
        }  # fmt: skip
        (folder / "transforms.json").write_text(json.dumps(value))
    return folder


def write_outlines(folder: Path, photo: Path, polygons: dict[str, list]) -> Path:
    """A file of outlines for a photo of SIZE x SIZE: a polygon for each name."""
    folder.mkdir(exist_ok=True)
    value = {
        "format": "instok3d-outlines-1", "photo": photo.name, "sha256": sha256_of(photo),
        "height": SIZE, "width": SIZE,
        "objects": [{"name": name, "polygons": [ring]} for name, ring in polygons.items()],
    }  # fmt: skip
    path = folder / f"{photo.stem}.json"
    path.write_text(json.dumps(value))
    return path
