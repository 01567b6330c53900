"""A COLMAP model of a scene's photos, in the scene's own world."""

from pathlib import Path

from instok3d.files import replacing_folder
from instok3d.formats.layouts import check_views
from instok3d.formats.photo_cameras import photo_cameras, solid_points
from instok3d.formats.statements import scene_comments
from instok3d.geometry.rotations import matrix_to_quat
from instok3d.scene.scene import Scene

FILES = ("cameras.txt", "images.txt", "points3D.txt")


def write_colmap(folder: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write cameras.txt, images.txt and points3D.txt, or nothing.

    One PINHOLE camera for each photo at its own size; the points are the centres of the Gaussians
    that are not faint, without tracks. Same world, lengths and axes as the scene and its PLY.

    Raises:
        FileExistsError: Something is there, and overwrite is off or it is no COLMAP model.
        ValueError: The scene has no views.
    """
    check_views(scene, "a COLMAP model")
    if folder.is_dir() and {file.name for file in folder.iterdir()} - set(FILES):
        raise FileExistsError(f"{folder} holds other things than a COLMAP model in text")
    about = [f"# {line}" for line in scene_comments(scene)]
    cameras, images = [*about], [*about]
    for number, camera in enumerate(photo_cameras(scene), 1):
        k = camera.intrinsics
        numbers = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        cameras.append(f"{number} PINHOLE {camera.width} {camera.height} {_words(numbers)}")
        quat = matrix_to_quat(camera.cam_from_world[:3, :3])
        pose = _words([*quat, *camera.cam_from_world[:3, 3]])
        images += [f"{number} {pose} {number} {camera.name}", ""]
    places, colors = solid_points(scene)
    points = [
        f"{number} {_words(place)} {' '.join(map(str, color))} 0"
        for number, (place, color) in enumerate(
            zip(places.tolist(), colors.tolist(), strict=True), 1
        )
    ]
    with replacing_folder(folder, overwrite=overwrite) as part:
        for name, lines in zip(FILES, (cameras, images, [*about, *points]), strict=True):
            (part / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _words(numbers: object) -> str:
    return " ".join(f"{float(value):.17g}" for value in numbers)  # pyright: ignore
