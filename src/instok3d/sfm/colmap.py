"""Incremental structure from motion by pycolmap, from matches to cameras and sparse points."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.sfm.matches import Keypoints, PhotoMatches

GUESSED_ANGLE_RAD = math.radians(65)
"""Field of view along the longer side of photos without a focal length in EXIF, to begin with:
phones have 65 to 70 degrees."""
LEAST_MATCHES = 15
"""A pair with fewer verified matches is not used, as in COLMAP itself."""

MOST_TRIALS = 2000
"""Of RANSAC for a pair. With a third of the matches right it is found with a probability of 0.999;
COLMAP's own 10,000 take up to half a minute for a pair whose matches are all wrong."""


@dataclass(frozen=True)
class RegisteredPhoto:
    """One photo whose camera was found."""

    number: int
    """Among the photos that were given."""
    cam_from_world: Float[Tensor, "4 4"]
    """float64, COLMAP's own world and unit."""
    intrinsics: Float[Tensor, "3 3"]
    """Of the upright original, float64: square pixels, principal point in the middle."""
    pixels: Float[Tensor, "point 2"]
    """Of the upright original: where the photo shows points whose place was found."""
    depths: Float[Tensor, " point"]
    """z-depths of these points in this camera, above 0."""


def pycolmap_module() -> Any:
    """The package pycolmap, silent but for errors.

    Raises:
        ModuleNotFoundError: It is not installed; says how to install it.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise ModuleNotFoundError(
            "geometry 'colmap' needs pycolmap: pip install 'instok3d[sfm]'"
        ) from error
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    return pycolmap


def register_photos(
    matches: PhotoMatches, progress: Callable[[str], None] = lambda text: None
) -> list[RegisteredPhoto]:
    """Cameras of all photos that COLMAP can register together, in the order of their numbers.

    Photos of one size and one focal length in EXIF share their intrinsics, which are those of a
    pinhole. The same matches give the same cameras: one thread, fixed seeds.

    Args:
        matches: Of at least two photos.
        progress: Called with how far it is.

    Returns:
        At least two photos, or none.

    Raises:
        ModuleNotFoundError: pycolmap is not installed.
    """
    pycolmap = pycolmap_module()
    with TemporaryDirectory(prefix="instok3d-") as folder:
        progress("verifying the matches")
        _write_database(pycolmap, Path(folder) / "database.db", matches)
        progress("registering the photos")
        found = pycolmap.incremental_mapping(
            Path(folder) / "database.db", Path(folder), Path(folder) / "models", _options(pycolmap)
        )
    # Photos that hang together in several separate groups give several models.
    best = max(
        found.values(), key=lambda each: (each.num_reg_images(), each.num_points3D()), default=None
    )
    if best is None or best.num_reg_images() < 2:
        return []
    images = sorted((each for each in best.images.values() if each.has_pose), key=_number)
    return [_registered(best, each, matches.keypoints[_number(each)]) for each in images]


def _write_database(pycolmap: Any, path: Path, matches: PhotoMatches) -> None:
    """Cameras, keypoints and verified matches; images are called by their numbers."""
    cameras: dict[tuple[int, int, float | None], Any] = {}
    own, ids = [], []
    database = pycolmap.Database.open(path)
    try:
        for number, keypoints in enumerate(matches.keypoints):
            camera = _camera(pycolmap, keypoints)
            key = (camera.width, camera.height, keypoints.focal)
            if key not in cameras:
                camera.camera_id = database.write_camera(camera)
                rig = pycolmap.Rig(rig_id=camera.camera_id)
                rig.add_ref_sensor(camera.sensor_id)
                database.write_rig(rig)
                cameras[key] = camera
            camera = cameras[key]
            image = pycolmap.Image(name=str(number), camera_id=camera.camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame(rig_id=camera.camera_id)
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            database.write_keypoints(image.image_id, keypoints.pixels.numpy())
            own.append(camera)
            ids.append(image.image_id)
        options = pycolmap.TwoViewGeometryOptions(min_num_inliers=LEAST_MATCHES)
        options.ransac.random_seed = 0
        options.ransac.max_num_trials = MOST_TRIALS
        for (a, b), rows in matches.pairs.items():
            if len(rows) < LEAST_MATCHES:
                continue
            pixels = [matches.keypoints[each].pixels.double().numpy() for each in (a, b)]
            verified = pycolmap.estimate_two_view_geometry(
                own[a], pixels[0], own[b], pixels[1], rows.numpy().astype("uint32"), options
            )
            if len(verified.inlier_matches) >= LEAST_MATCHES:
                database.write_two_view_geometry(ids[a], ids[b], verified)
    finally:
        database.close()


def _camera(pycolmap: Any, keypoints: Keypoints) -> Any:
    width, height = keypoints.pixel_map.width, keypoints.pixel_map.height
    focal = keypoints.focal or 0.5 * max(width, height) / math.tan(0.5 * GUESSED_ANGLE_RAD)
    return pycolmap.Camera(
        model="SIMPLE_PINHOLE",
        width=width,
        height=height,
        params=[focal, 0.5 * width, 0.5 * height],
        has_prior_focal_length=keypoints.focal is not None,
    )


def _options(pycolmap: Any) -> Any:
    options = pycolmap.IncrementalPipelineOptions(
        num_threads=1, random_seed=0, extract_colors=False, min_model_size=2
    )
    options.mapper.num_threads = 1
    options.mapper.random_seed = options.triangulation.random_seed = 0
    return options


def _number(image: Any) -> int:
    return int(image.name)


def _registered(model: Any, image: Any, keypoints: Keypoints) -> RegisteredPhoto:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.from_numpy(image.cam_from_world().matrix())
    seen = [point for point in image.points2D if point.has_point3D()]
    places = [torch.from_numpy(model.points3D[point.point3D_id].xyz) for point in seen]
    points = torch.stack(places) if places else pose.new_zeros(0, 3)
    depths = points @ pose[2, :3] + pose[2, 3]
    pixels = torch.tensor([point.xy.tolist() for point in seen], dtype=torch.float64).view(-1, 2)
    front = depths > 0
    matrix = torch.from_numpy(model.cameras[image.camera_id].calibration_matrix())
    return RegisteredPhoto(
        number=_number(image),
        cam_from_world=pose,
        intrinsics=keypoints.pixel_map.intrinsics_to_original(matrix),
        pixels=keypoints.pixel_map.to_original(pixels)[front].float(),
        depths=depths[front].float(),
    )
