import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.cli import main
from instok3d.formats.layouts import LAYOUTS, write_layout
from instok3d.formats.masks import coco_mask
from instok3d.formats.photo_cameras import photo_cameras
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.photos.camera_files import read_cameras
from instok3d.scene.scene import Scene
from splat_scenes import furnished_scene


def target(tmp_path: Path, name: str) -> Path:
    return tmp_path / f"out{(*LAYOUTS[name].suffixes, '')[0]}"


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_is_written_once_and_replaced_when_told(tmp_path: Path, scene: Scene, name: str):
    path = target(tmp_path, name)
    scene = replace(scene, units="metres")
    write_layout(name, path, scene)
    with pytest.raises(FileExistsError):
        write_layout(name, path, scene)
    write_layout(name, path, scene, overwrite=True)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("name", ["colmap", "nerfstudio", "masks"])
def test_a_scene_without_views_is_refused(tmp_path: Path, name: str):
    from imported_scene import imported_scene

    with pytest.raises(ValueError, match="was imported and has no views"):
        write_layout(name, target(tmp_path, name), imported_scene())
    assert not list(tmp_path.iterdir())


def test_pycolmap_opens_the_model_and_projects_like_us(tmp_path: Path):
    pycolmap = pytest.importorskip("pycolmap")
    scene = furnished_scene(300)
    write_layout("colmap", tmp_path / "sparse", scene)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse"))
    assert model.num_images() == len(scene.views)
    assert model.num_points3D() == int((scene.gaussians.opacities >= 0.5).sum())
    point = np.array([0.3, -0.2, 4.0])
    for number, camera in enumerate(photo_cameras(scene), 1):
        image = model.images[number]
        assert image.name == camera.name
        seen = image.project_point(point)
        homogeneous = torch.cat([torch.from_numpy(point), torch.ones(1, dtype=torch.float64)])
        x, y, z = camera.intrinsics @ (camera.cam_from_world @ homogeneous)[:3]
        np.testing.assert_allclose(seen, [float(x / z), float(y / z)], rtol=1e-9)


@pytest.mark.parametrize("name", ["colmap", "nerfstudio"])
def test_our_own_reader_finds_the_same_cameras(tmp_path: Path, name: str):
    scene = furnished_scene(50)
    path = tmp_path / ("sparse" if name == "colmap" else "transforms.json")
    write_layout(name, path, scene)
    again = read_cameras(path).cameras
    for mine, theirs in zip(photo_cameras(scene), again, strict=True):
        torch.testing.assert_close(theirs.cam_from_world.double(), mine.cam_from_world,
                                   atol=1e-6, rtol=0)  # fmt: skip
        assert (theirs.height, theirs.width) == (mine.height, mine.width)


def test_photos_of_one_name_stay_apart(scene: Scene):
    views = tuple(replace(view, file="my photo.jpg") for view in scene.views)
    names = [camera.name for camera in photo_cameras(replace(scene, views=views))]
    assert names == ["my_photo.jpg", "001_my_photo.jpg"]


def test_masks_hold_the_ids_and_coco_the_same(tmp_path: Path):
    scene = furnished_scene()
    write_layout("masks", tmp_path / "masks", scene)
    value = json.loads((tmp_path / "masks/instances.json").read_text())
    assert [each["name"] for each in value["categories"]] == ["object"]
    wanted = scene.render(ids=True).ids
    assert wanted is not None
    for image in value["images"]:
        file = Image.open(tmp_path / "masks" / image["ids_file"])
        ids = np.array(file)
        assert file.mode.startswith("I")
        np.testing.assert_array_equal(ids, wanted[image["id"] - 1].numpy())
        for each in value["annotations"]:
            if each["image_id"] == image["id"]:
                counts = each["segmentation"]["counts"]
                flat = np.repeat(np.arange(len(counts)) % 2, counts)
                np.testing.assert_array_equal(
                    flat.reshape(image["width"], image["height"]).T == 1,
                    ids == each["instance_id"],
                )
                assert each["area"] == (ids == each["instance_id"]).sum()


def test_a_mask_by_hand():
    # Columns one after the other: 1 inside, 2 outside, 1 inside, 0... begins inside.
    mask = np.array([[True, False], [False, True]])
    assert coco_mask(mask) == {
        "segmentation": {"size": [2, 2], "counts": [0, 1, 2, 1]},
        "bbox": [0, 0, 2, 2],
        "area": 2,
    }


def test_ros_boxes_have_x_forward_and_z_up(tmp_path: Path):
    scene = furnished_scene()
    with pytest.warns(UserWarning, match="units are arbitrary"):
        write_layout("ros", tmp_path / "a.json", scene)
    value = json.loads((tmp_path / "a.json").read_text())
    assert len(value["detections"]) == len(scene.objects)
    for detection, item in zip(value["detections"], scene.objects, strict=True):
        x, y, z = item.obb.center  # OpenCV: right, down, forward
        position = detection["bbox"]["center"]["position"]
        assert [position[a] for a in "xyz"] == pytest.approx([z, -x, -y], abs=1e-5)
        # Corners turned by the box's own rotation are the world's corners, turned.
        q = detection["bbox"]["center"]["orientation"]
        axes = quat_to_matrix(torch.tensor([q[a] for a in "wxyz"]))
        world = quat_to_matrix(torch.tensor(item.obb.quat_wxyz))
        turned = torch.stack([world[2], -world[0], -world[1]])
        torch.testing.assert_close(axes, turned, atol=1e-5, rtol=0)


def test_the_command_names_what_is_wrong(tmp_path: Path, scene: Scene, capsys):
    scene.save(tmp_path / "room.itk")
    room = str(tmp_path / "room.itk")
    assert main(["export", room, "--format", "colmap", "-o", str(tmp_path / "sparse")]) == 0
    assert main(["export", room, "--format", "colmap", "-o", str(tmp_path / "sparse")]) == 2
    assert main(["export", room, "--format", "ros", "-o", str(tmp_path / "a.txt")]) == 2
    assert "makes a file that ends in .json" in capsys.readouterr().err
    assert main(["export", room, "--format", "unity", "-o", str(tmp_path / "a")]) == 2
    assert "the formats are: colmap" in capsys.readouterr().err
    assert main(["export", room, "--format", "ros"]) == 2
