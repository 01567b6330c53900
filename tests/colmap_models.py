"""Small COLMAP models, binary or text, written without COLMAP."""

import struct

from instok3d.geometry.rotations import matrix_to_quat

MODELS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4,
          "OPENCV_FISHEYE": 5}  # fmt: skip


def write_colmap(folder, cameras, images, suffix: str) -> None:
    """cameras: id -> (model, width, height, parameters); images: (name, cam_from_world, camera).

    In place of a matrix there may be the seven numbers that the file is to hold: wxyz and xyz.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for number, (name, matrix, camera) in enumerate(images, start=1):
        pose = matrix
        if not isinstance(matrix, list):
            pose = [*matrix_to_quat(matrix[:3, :3]).tolist(), *matrix[:3, 3].tolist()]
        rows.append((number, pose, camera, name))
    if suffix == ".txt":
        lines = ["# Camera list"]
        lines += [
            f"{i} {m} {w} {h} {' '.join(map(repr, p))}" for i, (m, w, h, p) in cameras.items()
        ]
        (folder / "cameras.txt").write_text("\n".join(lines) + "\n")
        lines = ["# Image list"]
        for number, pose, camera, name in rows:
            points = "1.0 2.0 -1 3.5 4.5 7" if number % 2 else ""
            lines += [f"{number} {' '.join(map(repr, pose))} {camera} {name}", points]
        (folder / "images.txt").write_text("\n".join(lines) + "\n")
        return
    data = struct.pack("<Q", len(cameras))
    for number, (model, width, height, parameters) in cameras.items():
        data += struct.pack("<iiQQ", number, MODELS[model], width, height)
        data += struct.pack(f"<{len(parameters)}d", *parameters)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for number, pose, camera, name in rows:
        data += struct.pack("<i7di", number, *pose, camera) + name.encode() + b"\0"
        points = [(1.0, 2.0, -1), (3.5, 4.5, 7)] if number % 2 else []
        data += struct.pack("<Q", len(points)) + b"".join(struct.pack("<ddq", *p) for p in points)
    (folder / "images.bin").write_bytes(data)
