"""Cameras to look at a scene from: its inputs, a flight through or a sway around them, a file's."""

import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.camera_json import read_intrinsics, read_pose
from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.reading import naming_damage, read_json, whole_number
from instok3d.scene.picture_size import SizedCameras, check_picture_size, resize_cameras
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import Direction
from instok3d.types import Cameras, Gaussians

REMEDY = "give a list of cameras with cam_from_world, intrinsics, height and width"
SWAY = 0.12
"""Radius of the orbit in units of the distance to what it looks at. What no photo saw is empty,
so that the orbit stays near the photos."""
MAX_FRAMES = 100_000
"""More are taken for a slip: at 20 pictures a second this is a film of 83 minutes."""
FIELD_OF_VIEW_RAD, ABOVE_RAD = math.radians(50.0), math.radians(20.0)
"""Of the shorter side of pictures around a scene without inputs; how far above it they stand."""
WIDE = 0.9
"""Share of the Gaussians' centres that such pictures have room for: strays lie far out."""
STEEPEST = 0.9
"""Largest cosine between line of sight and vertical at which that keeps pictures upright."""


def camera_path(
    scene: Scene, name: str, frames: int, height: int | None = None, width: int | None = None
) -> SizedCameras:
    """The path of a name: "inputs", "through", "orbit", or a file like a scene's cameras.json.

    The pictures are never stretched to a size, see `resize_cameras`.

    Args:
        scene: What will be looked at.
        name: See above.
        frames: Number of cameras of an orbit or a flight, at least 1.
        height: Of the pictures; the scene's (or the file's) when both are None.
        width: Likewise.

    Raises:
        FileNotFoundError: No file of this name.
        ValueError: The file holds no cameras of one size, frames is not in 1..MAX_FRAMES, or the
            size is none that a picture can have.
    """
    if not 1 <= frames <= MAX_FRAMES:
        raise ValueError(f"frames must lie in 1..{MAX_FRAMES}, got {frames}")
    if name in ("inputs", "through"):
        if not scene.views:
            raise ValueError(
                'this scene was imported and has no input views: take the path "orbit" or a file '
                "like cameras.json"
            )
        cameras = scene.cameras if name == "inputs" else through(scene.cameras, frames)
        own = SizedCameras(cameras, scene.height, scene.width)
    elif name == "orbit":
        own = SizedCameras(orbit(scene, frames), scene.height, scene.width)
    else:
        own = read_camera_path(Path(name))
    return resize_cameras(own, height, width)


def through(cameras: Cameras, frames: int) -> Cameras:
    """A flight from camera to camera, in their order: as many frames between any two.

    Centres and intrinsics go straight from one to the next, rotations the shortest way.

    Args:
        cameras: At least one; with one alone all frames are that.
        frames: At least 1; the first and the last of two or more are the first and last camera.
    """
    # Imported here: it takes a quarter of a second, and every picture of a scene needs this file.
    from scipy.spatial.transform import Rotation, Slerp

    count = len(cameras.intrinsics)
    at = torch.linspace(0, count - 1, frames)
    before = at.floor().long().clamp_max(max(0, count - 2))
    after, share = (before + 1).clamp_max(count - 1), (at - before)[:, None, None]
    world_from_cam = invert_rigid(cameras.cam_from_world.detach().cpu())
    turns = Rotation.from_matrix(world_from_cam[:, :3, :3].double().numpy())
    mixed = turns if count == 1 else Slerp(np.arange(count), turns)(at.double().numpy())
    rotations = torch.from_numpy(mixed.as_matrix()).float().expand(frames, 3, 3)
    centers = world_from_cam[:, :3, 3]
    centers = centers[before] + share[:, 0] * (centers[after] - centers[before])
    intrinsics = cameras.intrinsics.detach().cpu()
    intrinsics = intrinsics[before] + share * (intrinsics[after] - intrinsics[before])
    return Cameras(invert_rigid(rigid(rotations, centers)), intrinsics)


def orbit(scene: Scene, frames: int) -> Cameras:
    """Cameras on a circle across the middle input's line of sight, all looking at one point.

    The point lies in front of that input, as far away as the Gaussians it sees lie in the median.
    The pictures stand upright by the scene's vertical, if that is known from given cameras, and
    else as that input does. Of a scene without inputs it goes all around, see `around`.
    """
    if not scene.views:
        return around(scene.drawn_gaussians(), scene.vertical.up, scene.height, scene.width, frames)
    middle = len(scene.views) // 2
    cam_from_world = scene.cameras.cam_from_world[middle]
    z = (scene.gaussians.means @ cam_from_world[:3, :3].mT + cam_from_world[:3, 3])[:, 2]
    in_front = z[z > 0]
    distance = float(in_front.median()) if len(in_front) else 1.0
    angle_rad = 2 * math.pi * torch.arange(frames) / frames
    radius = SWAY * distance
    centers = torch.stack(
        [radius * angle_rad.cos(), 0.5 * radius * angle_rad.sin(), torch.zeros(frames)], dim=1
    )
    target = torch.tensor([0.0, 0.0, distance])
    cam_from_middle = look_at(centers, target.expand(frames, 3), _down(scene, cam_from_world))
    return Cameras(
        cam_from_middle @ cam_from_world,
        scene.cameras.intrinsics[middle].expand(frames, 3, 3),
    )


def around(gaussians: Gaussians, up: Direction, height: int, width: int, frames: int) -> Cameras:
    """Cameras on a circle around Gaussians, somewhat above them, that have them in the picture.

    Args:
        gaussians: Unbatched.
        up: Of their world, unit length; the axis of the circle.
        height: Of the pictures, pixels.
        width: Likewise.
        frames: Number of cameras.
    """
    means = gaussians.means.detach().cpu().float()
    center, radius = torch.zeros(3), 1.0
    if len(means):
        center = means.median(dim=0).values
        distances = (means - center).norm(dim=1)
        radius = float(distances.kthvalue(math.ceil(WIDE * len(distances))).values) or 1.0
    up_axis = torch.tensor(up, dtype=torch.float32)
    aside = torch.eye(3)[int(up_axis.abs().argmin())]
    first = torch.nn.functional.normalize(torch.linalg.cross(up_axis, aside), dim=0)
    second = torch.linalg.cross(up_axis, first)
    angle_rad = 2 * math.pi * torch.arange(frames)[:, None] / frames
    level = angle_rad.cos() * first + angle_rad.sin() * second
    away = math.cos(ABOVE_RAD) * level + math.sin(ABOVE_RAD) * up_axis
    distance = radius / math.sin(0.5 * FIELD_OF_VIEW_RAD)
    cam_from_world = look_at(center + distance * away, center.expand(frames, 3), -up_axis)
    focal = 0.5 * min(height, width) / math.tan(0.5 * FIELD_OF_VIEW_RAD)
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Cameras(cam_from_world, intrinsics.expand(frames, 3, 3))


def _down(scene: Scene, cam_from_world: Float[Tensor, "4 4"]) -> Float[Tensor, " 3"]:
    """What shall point down in pictures from about a camera, in its frame."""
    down = cam_from_world[:3, :3] @ -torch.tensor(scene.vertical.up)
    source = scene.vertical.source
    known = source in ("given cameras", "given") and scene.vertical.is_stated
    if known and abs(float(down[2])) < STEEPEST:
        return down
    return torch.tensor([0.0, 1.0, 0.0])


def look_at(
    centers: Float[Tensor, "view 3"], targets: Float[Tensor, "view 3"], down: Float[Tensor, " 3"]
) -> Float[Tensor, "view 4 4"]:
    """cam_from_world of cameras at the centres that look at the targets.

    Args:
        centers: Where the cameras stand.
        targets: What lies in the middle of their pictures; not at the centres.
        down: The world's direction that shall point down in the pictures, not along a view.
    """
    forward = torch.nn.functional.normalize(targets - centers, dim=1)
    right = torch.nn.functional.normalize(
        torch.linalg.cross(down.expand_as(forward), forward), dim=1
    )
    true_down = torch.linalg.cross(forward, right)
    return invert_rigid(rigid(torch.stack([right, true_down, forward], dim=2), centers))


def read_camera_path(file: Path) -> SizedCameras:
    """Cameras of a JSON list of entries with cam_from_world, intrinsics, height and width.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is no such list, a camera cannot be, or the sizes differ.
    """
    if not file.is_file():
        raise FileNotFoundError(
            f"no camera path {file}: wanted 'inputs', 'orbit' or a file like cameras.json"
        )
    entries = read_json(file, REMEDY)
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{file} is no list of cameras; {REMEDY}")
    poses, intrinsics, sizes = [], [], set()
    for index, entry in enumerate(entries):
        where = f"{file}: camera {index}"
        with naming_damage(where, REMEDY):
            height, width = (whole_number(entry[name], 1) for name in ("height", "width"))
            check_picture_size(height, width)
            sizes.add((height, width))
            poses.append(read_pose(entry["cam_from_world"], where=where))
            intrinsics.append(
                read_intrinsics(entry["intrinsics"], where=where, height=height, width=width)
            )
    if len(sizes) > 1:
        raise ValueError(f"{file}: all cameras must have one picture size, found {sorted(sizes)}")
    cameras = Cameras(torch.stack(poses).float(), torch.stack(intrinsics).float())
    return SizedCameras(cameras, *sizes.pop())
