import json
import math
import struct
from pathlib import Path

import pytest
import torch
from PIL import Image

from colmap_models import write_colmap
from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.photos.camera_files import read_cameras
from instok3d.photos.cameras import CameraSet, PhotoCamera
from instok3d.photos.distortion import Distortion

IDENTITY = torch.eye(4).tolist()


def poses(count: int, rng: torch.Generator) -> torch.Tensor:
    quats = torch.randn(count, 4, generator=rng, dtype=torch.float64)
    return rigid(quat_to_matrix(quats), torch.randn(count, 3, generator=rng, dtype=torch.float64))


@pytest.mark.parametrize("place", ["", "sparse/0", "sparse"])
def test_colmap_binary_and_text_give_the_same_cameras(tmp_path, rng, place):
    cameras = {
        3: ("SIMPLE_RADIAL", 640, 480, [500.0, 320.0, 240.0, 0.01]),
        1: ("OPENCV", 800, 600, [700.0, 710.0, 400.0, 301.0, 0.01, -0.02, 0.001, 0.002]),
    }
    matrices = poses(3, rng)
    images = [("b 2.jpg", matrices[0], 3), ("a.jpg", matrices[1], 1), ("sub/c.jpg", matrices[2], 3)]
    for suffix in (".bin", ".txt"):
        write_colmap(tmp_path / suffix / place, cameras, images, suffix)
    binary, text = read_cameras(tmp_path / ".bin"), read_cameras(tmp_path / ".txt")
    assert [camera.name for camera in binary.cameras] == ["a.jpg", "b 2.jpg", "sub/c.jpg"]
    for one, other, matrix in zip(binary.cameras, text.cameras, matrices[[1, 0, 2]], strict=True):
        assert (one.name, one.height, one.width) == (other.name, other.height, other.width)
        assert one.distortion == other.distortion
        assert torch.equal(one.intrinsics, other.intrinsics)
        assert torch.equal(one.cam_from_world, other.cam_from_world)
        torch.testing.assert_close(one.cam_from_world, matrix)
    expected = torch.tensor([[700.0, 0, 400], [0, 710, 301], [0, 0, 1]]).double()
    assert torch.equal(binary.cameras[0].intrinsics, expected)
    assert binary.cameras[0].distortion == Distortion(0.01, -0.02, 0.001, 0.002)
    assert binary.units == "arbitrary"


@pytest.mark.parametrize(
    ("model", "parameters", "focal"),
    [
        ("SIMPLE_PINHOLE", [500.0, 30.0, 20.0], (500, 500)),
        ("PINHOLE", [500.0, 510.0, 30.0, 20.0], (500, 510)),
        ("RADIAL", [500.0, 30.0, 20.0, 0.1, 0.2], (500, 500)),
    ],
)
def test_colmap_lens_models_by_hand(tmp_path, model, parameters, focal):
    image = ("a.jpg", torch.eye(4).double(), 1)
    write_colmap(tmp_path, {1: (model, 60, 40, parameters)}, [image], ".bin")
    camera = read_cameras(tmp_path).cameras[0]
    expected = torch.tensor([[focal[0], 0, 30.0], [0, focal[1], 20], [0, 0, 1]]).double()
    assert torch.equal(camera.intrinsics, expected)
    assert camera.distortion == (Distortion(0.1, 0.2) if model == "RADIAL" else Distortion())


def test_colmap_fisheye_is_refused_with_its_name(tmp_path):
    image = ("a.jpg", torch.eye(4).double(), 1)
    cameras = {1: ("OPENCV_FISHEYE", 60, 40, [50.0, 50, 30, 20, 0, 0, 0, 0])}
    write_colmap(tmp_path, cameras, [image], ".bin")
    with pytest.raises(ValueError, match="OPENCV_FISHEYE is not supported; undistort"):
        read_cameras(tmp_path)


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_cut_colmap_files_are_an_error(tmp_path, name, part):
    images = [(f"{i}.jpg", torch.eye(4).double(), 1) for i in range(3)]
    write_colmap(tmp_path, {1: ("PINHOLE", 60, 40, [50.0, 50, 30, 20])}, images, ".bin")
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(part * len(data))])
    with pytest.raises(ValueError, match="cut off"):
        read_cameras(tmp_path)


def test_a_colmap_header_that_promises_too_much_is_an_error(tmp_path):
    write_colmap(tmp_path, {}, [], ".bin")
    (tmp_path / "images.bin").write_bytes(struct.pack("<Q", 2**60))
    with pytest.raises(ValueError, match="cut off"):
        read_cameras(tmp_path)


def transforms(**changes) -> dict:
    frame = {"file_path": "images/a.jpg", "transform_matrix": IDENTITY}
    base = {"w": 640, "h": 480, "fl_x": 500.0, "fl_y": 505.0, "cx": 320.0, "cy": 240.0}
    return {**base, "frames": [frame], **changes}


def write(path, data) -> None:
    path.write_text(json.dumps(data))


def test_axes_of_transforms_json_by_hand(tmp_path):
    # OpenGL camera at (1, 2, 3), not turned: it looks along -z with +y up. In OpenCV axes a
    # world point one unit ahead and a half up, (1, 2.5, 2), is at x = 0, y = -0.5, z = 1.
    matrix = torch.eye(4)
    matrix[:3, 3] = torch.tensor([1.0, 2.0, 3.0])
    frame = {"file_path": "./images/a.jpg", "transform_matrix": matrix.tolist()}
    write(tmp_path / "transforms.json", transforms(frames=[frame]))
    camera = read_cameras(tmp_path).cameras[0]
    point = camera.cam_from_world @ torch.tensor([1.0, 2.5, 2.0, 1.0]).double()
    torch.testing.assert_close(point, torch.tensor([0.0, -0.5, 1.0, 1.0]).double())
    expected = torch.tensor([[500.0, 0, 320], [0, 505, 240], [0, 0, 1]]).double()
    assert torch.equal(camera.intrinsics, expected)


def test_transforms_with_an_angle_takes_the_size_from_the_photo(tmp_path):
    # 90 degrees across 200 pixels: focal length 100; the middle of 200 x 100 is (100, 50).
    (tmp_path / "train").mkdir()
    Image.new("RGB", (200, 100)).save(tmp_path / "train" / "r_0.png")
    frames = [{"file_path": "./train/r_0", "transform_matrix": IDENTITY}]
    write(tmp_path / "transforms.json", {"camera_angle_x": math.pi / 2, "frames": frames})
    camera = read_cameras(tmp_path / "transforms.json").cameras[0]
    assert (camera.height, camera.width) == (100, 200)
    expected = torch.tensor([[100.0, 0, 100], [0, 100, 50], [0, 0, 1]]).double()
    torch.testing.assert_close(camera.intrinsics, expected)


def test_what_a_frame_says_goes_before_what_the_file_says(tmp_path):
    frame = {"file_path": "a.jpg", "transform_matrix": IDENTITY, "fl_x": 300.0, "k1": 0.1}
    write(tmp_path / "transforms.json", transforms(frames=[frame]))
    camera = read_cameras(tmp_path).cameras[0]
    assert camera.intrinsics[0, 0] == 300
    assert camera.distortion == Distortion(k1=0.1)


def scene(**changes) -> dict:
    frame = {"color": "color/0.jpg", "depth": "depth/0.png", "c2w": IDENTITY}
    matrix = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
    return {
        "width": 640,
        "height": 480,
        "K": matrix,
        "depth_scale": 500,
        "frames": [frame],
        **changes,
    }


def test_scene_json_is_metric_and_gives_depth(tmp_path, rng):
    world_from_cam = poses(1, rng)[0]
    frame = {"color": "color/0.jpg", "depth": "depth/0.png", "c2w": world_from_cam.tolist()}
    write(tmp_path / "scene.json", scene(frames=[frame]))
    cameras = read_cameras(tmp_path)
    camera = cameras.cameras[0]
    assert cameras.units == "metres"
    assert camera.depth_path == tmp_path / "depth" / "0.png"
    assert camera.depth_scale == 500
    torch.testing.assert_close(camera.cam_from_world, invert_rigid(world_from_cam))


def _frame(matrix) -> list[dict]:
    return [{"color": "a.jpg", "c2w": matrix}]


MIRRORED = torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0])).tolist()
FAR = [[1, 0, 0, 1e30], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
SHEARED = [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (scene(frames=_frame(MIRRORED)), "json: a.jpg has a mirrored camera"),
        (scene(frames=_frame(SHEARED)), "not orthonormal"),
        (scene(frames=_frame([[math.nan] * 4] * 4)), "not finite"),
        (scene(frames=_frame([[1, 0], [0, 1]])), r"matrix of \[2, 2\], wanted 4 x 4"),
        (scene(frames=_frame("eye")), "matrix that is not 4 x 4 numbers"),
        (
            scene(frames=_frame([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 1]])),
            "last row",
        ),
        (scene(K=[[-5, 0, 320], [0, 500, 240], [0, 0, 1]]), "focal length .* above 0"),
        (scene(K=[[500, 0, 320], [3, 500, 240], [0, 0, 1]]), "0.jpg has .* 3 below the diagonal"),
        (scene(K=[[500, 0, 320], [0, 500, 240], [0, 1, 1]]), "last row is 0 1 1"),
        (scene(K=[[500, 80, 320], [0, 500, 240], [0, 0, 1]]), "skew of 80"),
        (scene(K=[[0.8, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]), "focal lengths .* another size"),
        (scene(K=[[math.nan, 0, 320], [0, 500, 240], [0, 0, 1]]), "intrinsics .* not finite"),
        (scene(frames=_frame(FAR)), r"stands 1e\+30 units from the origin"),
        (scene(K=[[500, 0, 960], [0, 500, 540], [0, 0, 1]]), "principal point .* another size"),
        (scene(K=None), "matrix that is not 3 x 3"),
        (scene(depth_scale=math.nan), "depth_scale must be finite"),
        (scene(depth_scale=1e-30), "depth scale must be above 0 and finite"),
        (scene(depth_scale=-1000), "depth scale must be above 0"),
        (scene(k3=-3, k1=math.inf), "k1 must be finite"),
        (scene(camera_model="FULL_OPENCV"), "lens model FULL_OPENCV; undistort"),
        (scene(dist_coeffs=[0, 0, 0, 0, 0.2]), "lens term dist_coeffs, which is not read"),
        (scene(width=640.5), "width must be a whole number of pixels"),
        (scene(frames=2 * _frame(IDENTITY)), "names 1 photos more than once, such as a.jpg"),
        (scene(frames=[{"color": ["a"], "c2w": IDENTITY}]), "color must be the name of a file"),
        (scene(frames=[{"color": " ", "c2w": IDENTITY}]), "color must be the name of a file"),
        (scene(depth_scale=0), "depth scale must be above 0"),
        (scene(width="wide"), "width must be a number, got 'wide'"),
        (scene(height=math.inf), "height must be finite"),
        (scene(height=0), "cannot have 640 x 0 pixels"),
        (scene(width=10**9), "cannot have 1000000000 x 480 pixels"),
        (scene(frames=[]), "holds no camera"),
        (scene(frames=[{"c2w": IDENTITY}]), "lacks the field 'color'"),
        ({"images": []}, "no list of frames"),
        ([1, 2], "no list of frames"),
        (transforms(camera_model="OPENCV_FISHEYE"), "lens model OPENCV_FISHEYE; undistort"),
        *(
            (transforms(camera_model=model), f"lens model {model}; undistort")
            for model in ("FULL_OPENCV", "THIN_PRISM_FISHEYE", "EQUIRECTANGULAR", "FOV", "fisheye")
        ),
        *(
            (transforms(**{key: value}), f"lens term {key}, which is not read; undistort")
            for key, value in {
                "k4": 0.01,
                "k5": -1e-9,
                "k6": math.nan,
                "s1": 0.1,
                "s4": 1,
                "tau_x": 0.1,
                "is_fisheye": True,
                "distortion_params": [0, 0.1],
                "distortion": {"k1": 0.1},
                "dist_coeffs": "0.1 0 0 0",
            }.items()
        ),
        (transforms(k3=math.nan), "k3 must be finite"),
        (transforms(p2="0.1"), "p2 must be a number"),
        (transforms(fl_x=0), "focal length 0, which must be above 0"),
        (transforms(fl_y=-500), "focal length -500, which must be above 0"),
        (transforms(cx=-1), "principal point"),
        (transforms(depth_unit_scale_factor=0), "number out of range"),
        (transforms(depth_unit_scale_factor=-0.001), "depth scale must be above 0"),
        (
            {"w": 640, "h": 480, "camera_angle_x": 3.5, "frames": transforms()["frames"]},
            "camera_angle_x must lie between 0 and pi",
        ),
        (transforms(frames=[{"file_path": "a.jpg"}]), "lacks the field 'transform_matrix'"),
        ({"frames": [{"file_path": "a.jpg", "transform_matrix": IDENTITY}]}, "gives no w and h"),
    ],
)
def test_a_bad_camera_file_is_named_with_its_fault(tmp_path, data, message):
    write(tmp_path / "cameras.json", data)
    with pytest.raises(ValueError, match=message) as caught:
        read_cameras(tmp_path / "cameras.json")
    assert "cameras.json" in str(caught.value)


def test_terms_that_are_zero_or_not_there_are_no_lens(tmp_path):
    nothing = {"k4": 0, "k5": None, "s1": 0.0, "is_fisheye": False, "distortion_params": [0, 0.0],
               "dist_coeffs": [], "k1": None, "camera_model": None}  # fmt: skip
    for name, data in {"a.json": transforms(**nothing), "b.json": scene(**nothing)}.items():
        write(tmp_path / name, data)
        assert read_cameras(tmp_path / name).cameras[0].distortion == Distortion()


def test_every_term_that_is_read_counts(tmp_path):
    terms = {"k1": 0.01, "k2": -0.02, "p1": 0.001, "p2": 0.002, "k3": -0.03}
    for name, data in {"a.json": transforms(**terms), "b.json": scene(**terms)}.items():
        write(tmp_path / name, data)
        assert read_cameras(tmp_path / name).cameras[0].distortion == Distortion(**terms)


def test_two_angles_are_two_focal_lengths(tmp_path):
    data = {"w": 200, "h": 100, "camera_angle_x": math.pi / 2, "camera_angle_y": math.pi / 2}
    write(tmp_path / "a.json", {**data, "frames": transforms()["frames"]})
    focal = read_cameras(tmp_path / "a.json").cameras[0].intrinsics.diagonal()[:2]
    assert focal.tolist() == pytest.approx([100, 50])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_json_may_begin_with_a_byte_order_mark(tmp_path, encoding):
    (tmp_path / "transforms.json").write_bytes(json.dumps(transforms()).encode(encoding))
    assert len(read_cameras(tmp_path).cameras) == 1


def test_json_may_name_a_file_by_bytes_that_are_no_text(tmp_path):
    text = json.dumps(transforms()).encode().replace(b"a.jpg", b"\xff.jpg")
    (tmp_path / "transforms.json").write_bytes(text)
    assert read_cameras(tmp_path).cameras[0].name == "images/\udcff.jpg"


@pytest.mark.parametrize("name", ["../depth.png", "/depth.png", "..\\depth.png"])
def test_depth_outside_of_the_folder_must_be_asked_for(tmp_path, name):
    frame = {"color": "a.jpg", "depth": name, "c2w": IDENTITY}
    write(tmp_path / "scene.json", scene(frames=[frame]))
    with pytest.raises(ValueError, match=r"outside of the folder .* --allow-outside"):
        read_cameras(tmp_path)
    (camera,) = read_cameras(tmp_path, allow_outside=True).cameras
    assert camera.depth_path is not None


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
@pytest.mark.parametrize(
    ("lens", "shift", "message"),
    [
        ([-500.0, 500, 320, 240], 0.0, "focal length -500, which must be above 0"),
        ([500.0, 0, 320, 240], 0.0, "focal length 0"),
        ([500.0, math.nan, 320, 240], 0.0, "not finite"),
        ([500.0, 500, 960, 240], 0.0, "principal point"),
        ([0.8, 0.8, 0.5, 0.5], 0.0, "another size"),
        ([500.0, 500, 320, 240], 1e30, r"stands 1e\+30 units"),
        ([500.0, 500, 320, 240], math.nan, "not finite"),
    ],
)
def test_colmap_cameras_that_make_no_sense_are_refused(tmp_path, suffix, lens, shift, message):
    pose = torch.eye(4).double()
    pose[0, 3] = shift
    write_colmap(tmp_path, {1: ("PINHOLE", 640, 480, lens)}, [("a.jpg", pose, 1)], suffix)
    with pytest.raises(ValueError, match=rf"a\.jpg .*{message}"):
        read_cameras(tmp_path)


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_a_colmap_lens_that_is_not_finite_is_refused(tmp_path, suffix):
    lens = {1: ("OPENCV", 640, 480, [500.0, 500, 320, 240, 0, math.nan, 0, 0])}
    write_colmap(tmp_path, lens, [("a.jpg", torch.eye(4).double(), 1)], suffix)
    with pytest.raises(ValueError, match="lens distortion that is not finite"):
        read_cameras(tmp_path)


@pytest.mark.parametrize(
    ("model", "count"),
    [("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4),
     ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
     ("EUCM", 6)],
)  # fmt: skip
def test_every_other_colmap_lens_is_refused_by_name(tmp_path, model, count):
    parameters = " ".join(["30"] * count)
    (tmp_path / "cameras.txt").write_text(f"1 {model} 60 60 {parameters}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.jpg\n\n")
    with pytest.raises(ValueError, match=rf"a\.jpg: COLMAP's lens model {model} is not supported"):
        read_cameras(tmp_path)


def test_a_colmap_folder_that_names_a_photo_twice_is_refused(tmp_path):
    images = [("a.jpg", torch.eye(4).double(), 1)] * 2
    write_colmap(tmp_path, {1: ("PINHOLE", 60, 40, [50.0, 50, 30, 20])}, images, ".bin")
    with pytest.raises(ValueError, match=r"names 1 photos more than once, such as a\.jpg"):
        read_cameras(tmp_path)


def test_text_that_is_not_json_is_an_error(tmp_path):
    for text in ("{", "[" * 100_000):
        (tmp_path / "a.json").write_text(text)
        with pytest.raises(ValueError, match=r"a\.json is not valid JSON"):
            read_cameras(tmp_path / "a.json")


def test_a_nearly_orthonormal_rotation_becomes_exact(tmp_path):
    rounded = [[0.707, -0.707, 0, 1], [0.707, 0.707, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    write(tmp_path / "scene.json", scene(frames=_frame(rounded)))
    rotation = read_cameras(tmp_path).cameras[0].cam_from_world[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3).double(), atol=1e-12, rtol=0)
    assert rotation[0, 0] == pytest.approx(math.sqrt(0.5), abs=1e-12)


def test_nothing_and_too_much_in_a_folder_are_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match="no camera file or folder"):
        read_cameras(tmp_path / "none")
    with pytest.raises(FileNotFoundError, match="holds no cameras: wanted COLMAP"):
        read_cameras(tmp_path)
    write(tmp_path / "scene.json", scene())
    write(tmp_path / "transforms.json", transforms())
    with pytest.raises(ValueError, match=r"several sets .*scene\.json, transforms\.json"):
        read_cameras(tmp_path)


def camera(name: str) -> PhotoCamera:
    return PhotoCamera(name, 4, 4, torch.eye(3).double(), torch.eye(4).double())


def test_photos_find_their_cameras_by_path_then_name_then_stem(tmp_path):
    cameras = CameraSet(
        (camera("x/1.jpg"), camera("y/1.jpg"), camera("z/2.png")), tmp_path, "metres"
    )
    photos = [tmp_path / "y" / "1.jpg", tmp_path / "elsewhere" / "2.png", tmp_path / "2.jpg"]
    assert [found.name for found in cameras.of(photos)] == ["y/1.jpg", "z/2.png", "z/2.png"]


def test_photos_find_their_cameras_whatever_wrote_the_names():
    cameras = CameraSet(
        (
            camera("images\\left\\1.jpg"),
            camera("./images/right/1"),
            camera("frame.0001"),
            camera("frame.0002.JPG"),
            camera("Caf\u00e9.png"),
        ),
        Path("a.json"),
        "metres",
    )
    photos = ["images/left/1.jpg", "images/right/1.webp", "x/frame.0001.jpg", "frame.0002.jpeg",
              "cafe\u0301.png"]  # fmt: skip
    found = cameras.of([Path(photo) for photo in photos])
    assert [each.name for each in found] == [each.name for each in cameras.cameras]


def test_the_longest_path_that_fits_goes_first():
    cameras = CameraSet((camera("1.jpg"), camera("x/1.jpg")), Path("a.json"), "metres")
    (found,) = cameras.of([Path("y/x/1.jpg")])
    assert found.name == "x/1.jpg"


def test_photos_without_a_camera_are_all_listed(tmp_path):
    cameras = CameraSet((camera("1.jpg"),), tmp_path, "metres")
    photos = [tmp_path / name for name in ("1.jpg", "2.jpg", "3.jpg")]
    with pytest.raises(ValueError, match=r"no camera for 2 of 3 photos: 2\.jpg, 3\.jpg"):
        cameras.of(photos)


def test_a_photo_that_two_cameras_fit_is_an_error(tmp_path):
    cameras = CameraSet((camera("x/1.jpg"), camera("y/1.jpg")), tmp_path, "metres")
    with pytest.raises(
        ValueError, match=r"2 cameras .* fit the photo .*1\.jpg: x/1\.jpg, y/1\.jpg"
    ):
        cameras.of([tmp_path / "z" / "1.jpg"])


def test_distortion_at_the_corner_by_hand():
    # f = 100 on 200 x 200: the corner is at (-1, -1), r^2 = 2; k1 = 0.01 moves it by 2 % of its
    # distance of 141.4 pixels from the middle, 2.83 pixels, which is 1 % of the diagonal.
    intrinsics = torch.tensor([[100.0, 0, 100], [0, 100, 100], [0, 0, 1]]).double()
    lens = PhotoCamera("a", 200, 200, intrinsics, torch.eye(4).double(), Distortion(0.01))
    assert lens.distortion_shift == pytest.approx(0.01)


LONG = ["x" * 5000, [1] * 5000, {"x" * 5000: 1}, [["x" * 5000]]]


@pytest.mark.parametrize("value", LONG)
@pytest.mark.parametrize(
    "key", ["file_path", "transform_matrix", "w", "fl_x", "cx", "k1", "camera_model", "frames"]
)
def test_a_long_value_does_not_fill_the_message(tmp_path, key, value):
    frame = {"file_path": "images/a.jpg", "transform_matrix": IDENTITY}
    data = transforms(frames=[frame])
    (frame if key in frame else data)[key] = value
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    with pytest.raises(ValueError, match=r"transforms\.json") as error:
        read_cameras(tmp_path / "transforms.json")
    assert len(str(error.value)) < 600
