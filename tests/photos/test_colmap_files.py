from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from instok3d.photos.camera_files import read_cameras
from instok3d.photos.colmap_files import read_model

PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")


def written_by_pycolmap(folder: Path, suffix: str, models: list[str]) -> Any:
    """A model with one image for each lens, with and without 2D points and 3D points."""
    pycolmap = pytest.importorskip("pycolmap", reason="compares with what pycolmap writes")
    model, rng = pycolmap.Reconstruction(), np.random.default_rng(0)
    for number, name in enumerate(models, start=3):
        lens = pycolmap.CameraModelId.__members__[name]
        camera = pycolmap.Camera.create_from_model_id(number, lens, 500.0, 640, 480)
        camera.params = [value + 0.001 * k for k, value in enumerate(camera.params)]
        model.add_camera_with_trivial_rig(camera)
        # Names in the reverse order of the ids, one with a space.
        image = pycolmap.Image(
            name=f"left/{len(models) - number:02d} {name}.jpg",
            keypoints=rng.uniform(0, 400, (number % 3, 2)),
            camera_id=number,
            image_id=2 * number,
        )
        quat = rng.normal(size=4)
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(quat / np.linalg.norm(quat)), rng.normal(size=3)
        )
        model.add_image_with_trivial_frame(image, pose)
    model.add_point3D(np.ones(3), pycolmap.Track(), np.zeros(3, dtype=np.uint8))
    folder.mkdir()
    (model.write_binary if suffix == ".bin" else model.write_text)(str(folder))
    return model


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_every_lens_and_pose_that_pycolmap_writes_is_read(tmp_path, suffix):
    pycolmap = pytest.importorskip("pycolmap", reason="compares with what pycolmap writes")
    lenses = [name for name in pycolmap.CameraModelId.__members__ if name != "INVALID"]
    assert len(lenses) >= 12
    model = written_by_pycolmap(tmp_path / "model", suffix, lenses)
    found = read_model(tmp_path / "model")
    assert [image.name for image in found] == sorted(i.name for i in model.images.values())
    for image in found:
        true = model.images[image.number]
        assert image.name == true.name
        assert image.camera.model == true.camera.model.name
        assert (image.camera.height, image.camera.width) == (480, 640)
        assert image.camera.parameters == pytest.approx(true.camera.params.tolist(), abs=1e-12)
        pose = torch.from_numpy(true.cam_from_world().matrix())
        assert torch.allclose(image.rotation, pose[:, :3], atol=1e-12)
        assert torch.allclose(image.translation, pose[:, 3], atol=1e-12)


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_pinhole_lenses_project_as_pycolmap_does(tmp_path, suffix):
    model = written_by_pycolmap(tmp_path / "model", suffix, list(PINHOLES))
    for camera in read_cameras(tmp_path / "model").cameras:
        (true,) = [i for i in model.images.values() if i.name == camera.name]
        x, y = 0.2, -0.1
        r2 = x * x + y * y
        k1, k2, p1, p2, _ = astuple(camera.distortion)
        radial = 1 + k1 * r2 + k2 * r2 * r2
        bent = torch.tensor(
            [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
             y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y, 1.0], dtype=torch.float64
        )  # fmt: skip
        pixel = true.camera.img_from_cam(np.array([x, y, 1.0]))
        assert (camera.intrinsics @ bent)[:2].tolist() == pytest.approx(pixel.tolist(), abs=1e-9)


def test_other_lenses_are_refused_with_their_name(tmp_path):
    written_by_pycolmap(tmp_path / "model", ".bin", ["PINHOLE", "THIN_PRISM_FISHEYE"])
    with pytest.raises(ValueError, match="THIN_PRISM_FISHEYE is not supported; undistort"):
        read_cameras(tmp_path / "model")
