import warnings

import pytest
import torch

from instok3d.errors import NotEnoughMemoryError
from instok3d.geometry.cameras import project
from instok3d.scene.paths import camera_path
from instok3d.scene.picture_size import (
    MAX_PICTURE_PIXELS,
    SizedCameras,
    check_picture_size,
    resize_cameras,
)
from instok3d.scene.scene import Scene
from instok3d.types import Cameras
from made_scene import HEIGHT, WIDTH


def square() -> SizedCameras:
    intrinsics = torch.tensor([[[100.0, 0, 60], [0, 100, 64], [0, 0, 1]]])
    return SizedCameras(Cameras(torch.eye(4)[None], intrinsics), 128, 128)


def test_a_wider_picture_sees_more_by_hand():
    # 384 x 216 from 128 x 128: the scale is 216 / 128 = 1.6875, so 216 of the 384 columns are
    # those of before and 84 more lie on each side. cx: 60 * 1.6875 + 84 = 185.25.
    with pytest.warns(UserWarning, match=r"384 x 216 .* see 97 degrees across instead of 65"):
        wide = resize_cameras(square(), 216, 384)
    assert (wide.height, wide.width) == (216, 384)
    wanted = torch.tensor([[168.75, 0, 185.25], [0, 168.75, 108], [0, 0, 1]])
    torch.testing.assert_close(wide.cameras.intrinsics[0], wanted)


@pytest.mark.parametrize(
    ("height", "width"), [(216, 384), (500, 100), (7, 1000), (129, 128), (None, 77), (77, None)]
)
@pytest.mark.filterwarnings("ignore:pictures of")
def test_pixels_stay_square_and_all_that_was_seen_stays_in_the_picture(height, width):
    sized = resize_cameras(square(), height, width)
    intrinsics = sized.cameras.intrinsics
    assert float(intrinsics[0, 0, 0]) == pytest.approx(float(intrinsics[0, 1, 1]))
    corners = torch.tensor([[[-0.6, -0.64, 1], [0.68, -0.64, 1], [0.68, 0.64, 1], [-0.6, 0.64, 1]]])
    x, y = project(corners, intrinsics)[0].unbind(-1)
    # Rounding to whole pixels of the side that follows costs half a one.
    assert -0.51 < float(x.min()) < float(x.max()) < sized.width + 0.51
    assert -0.51 < float(y.min()) < float(y.max()) < sized.height + 0.51


@pytest.mark.parametrize(("height", "width"), [(48, None), (None, 64), (48, 64), (None, None)])
def test_one_side_alone_keeps_the_shape_and_says_nothing(scene: Scene, height, width):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        path = camera_path(scene, "inputs", 1, height, width)
    factor = path.height / HEIGHT
    assert (path.height, path.width) == (factor * HEIGHT, factor * WIDTH)
    change = torch.tensor([[factor], [factor], [1.0]])
    torch.testing.assert_close(path.cameras.intrinsics, change * scene.cameras.intrinsics)


@pytest.mark.parametrize(
    ("height", "width"),
    [(0, None), (None, 0), (0, 0), (-24, 32), (None, 10**9), (2**13, 2**13)],
)
def test_sizes_that_no_picture_has_are_refused_wherever_one_is_rendered(
    scene: Scene, height, width
):
    for case in (
        lambda: camera_path(scene, "orbit", 1, height, width),
        lambda: scene.render([0], height, width),
        lambda: scene.render(scene.cameras, height, width),
    ):
        with pytest.raises(ValueError, match=r"height must|width must|a picture may have"):
            case()


def test_the_largest_picture_is_one_of_eight_thousand_columns():
    check_picture_size(4320, 7680)
    with pytest.raises(ValueError, match="33,554,432"):
        check_picture_size(MAX_PICTURE_PIXELS + 1, 1)


def test_ids_that_would_not_fit_in_memory_are_refused(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("instok3d.model.memory.available_bytes", lambda device: 10**6)
    monkeypatch.setattr("instok3d.model.memory.resident_bytes", lambda: 0)
    with pytest.raises(NotEnoughMemoryError, match=r"object ids of pictures of 400 x 300"):
        scene.render([0], 300, 400, ids=True)
    assert scene.render([0], 300, 400).ids is None


@pytest.mark.filterwarnings("ignore:pictures of")
def test_a_wider_picture_of_a_scene_has_the_old_one_in_its_middle(scene: Scene):
    wide = scene.render([0], HEIGHT, 3 * WIDTH).colors
    middle = wide[..., WIDTH : 2 * WIDTH]
    torch.testing.assert_close(middle, scene.render([0]).colors, atol=1e-4, rtol=0)
