"""What `render` and the kernels refuse: sizes that would be read beyond the end of an array."""

from dataclasses import replace

import pytest
import torch

from instok3d.render import checks, render
from instok3d.render.native_backend import _rasterizer
from instok3d.types import Cameras, Gaussians


def unchecked(stage: Gaussians | Cameras, name: str, value: torch.Tensor) -> Gaussians | Cameras:
    """The stage with another field, past the checks of the types, which only run in tests."""
    changed = replace(stage)
    object.__setattr__(changed, name, value)
    return changed


LAST_AXES = {
    "means": (3, [0, 2, 4]), "quats": (4, [0, 3, 5]), "scales": (3, [0, 2, 4]),
    "sh": (3, [0, 1, 4]),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "length"), [(n, k) for n, (_, ks) in LAST_AXES.items() for k in ks]
)
def test_a_wrong_last_axis_is_refused_by_name(make_scene, name: str, length: int):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    old = getattr(gaussians, name)
    wrong = unchecked(gaussians, name, torch.zeros(*old.shape[:-1], length))
    with pytest.raises(ValueError, match=rf"gaussians\.{name} has the shape .*wanted"):
        render(wrong, cameras, 8, 8)


@pytest.mark.parametrize("name", ["opacities", "anchor_index"])
def test_an_axis_too_many_is_refused(make_scene, name: str):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    wrong = unchecked(gaussians, name, getattr(gaussians, name)[:, None])
    with pytest.raises(
        ValueError, match=rf"gaussians\.{name} has the shape \(5, 1\), wanted \(5,\)"
    ):
        render(wrong, cameras, 8, 8)


@pytest.mark.parametrize(
    ("name", "shape"), [("cam_from_world", (2, 3, 4)), ("intrinsics", (2, 3, 4))]
)
def test_cameras_of_another_shape_are_refused(make_scene, name: str, shape: tuple[int, ...]):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    with pytest.raises(ValueError, match=rf"cameras\.{name} has the shape \(2, 3, 4\)"):
        render(gaussians, unchecked(cameras, name, torch.zeros(shape)), 8, 8)


def test_types_and_devices_that_differ_are_refused(make_scene):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    with pytest.raises(ValueError, match=r"anchor_index is torch\.float32"):
        render(unchecked(gaussians, "anchor_index", torch.zeros(5)), cameras, 8, 8)
    with pytest.raises(ValueError, match=r"scales is torch\.int64"):
        render(unchecked(gaussians, "scales", torch.ones(5, 3, dtype=torch.long)), cameras, 8, 8)
    with pytest.raises(ValueError, match=r"quats lies on meta, gaussians\.means on cpu"):
        render(replace(gaussians, quats=gaussians.quats.to("meta")), cameras, 8, 8)


def test_a_picture_that_no_memory_holds_is_refused_before_any_is_asked_for(make_scene):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    with pytest.raises(ValueError, match="more than 67108864 pixels"):
        render(gaussians, cameras, checks.MAX_PIXELS, 2)


def test_the_largest_picture_and_planes_that_touch_are_accepted():
    checks.check_picture(8192, 8192, 0.0, 0.0)
    checks.check_picture(1, 1, 2.0, float("inf"))


@pytest.mark.parametrize("dtype", [torch.bool, torch.complex64])
def test_an_anchor_index_that_does_not_count_is_refused(make_scene, dtype: torch.dtype):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    wrong = unchecked(gaussians, "anchor_index", torch.zeros(5, dtype=dtype))
    with pytest.raises(ValueError, match=rf"anchor_index is {dtype}, wanted whole numbers"):
        render(wrong, cameras, 8, 8)


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.parametrize("number", [-1, 7, 2**40])
def test_an_anchor_without_features_is_refused(make_scene, backend: str, number: int):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    gaussians.anchor_index[2] = number
    with pytest.raises(ValueError, match="anchor_index has a number without a row"):
        render(gaussians, cameras, 8, 8, anchor_features=torch.zeros(7, 2), backend=backend)


@pytest.mark.parametrize("near_far", [(2.0, 1.0), (-1.0, 9.0), (float("nan"), 9.0)])
def test_planes_out_of_order_are_refused(make_scene, near_far: tuple[float, float]):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    near, far = near_far
    with pytest.raises(ValueError, match="0 <= near <= far, got"):
        render(gaussians, cameras, 8, 8, near=near, far=far)


def test_a_background_that_is_not_one_colour_is_refused(make_scene):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    with pytest.raises(ValueError, match=r"background has the shape \(4,\), wanted three numbers"):
        render(gaussians, cameras, 8, 8, background=(0.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize("count", [0, 3])
@pytest.mark.parametrize("views", [0, 2])
def test_no_gaussians_and_no_views_are_pictures_of_nothing(make_scene, count: int, views: int):
    gaussians, cameras = make_scene(count=count, views=views, dtype=torch.float32)
    gaussians.means.requires_grad_()
    for backend in ("native", "reference"):
        pictures = render(gaussians, cameras, 6, 8, backend=backend)
        assert pictures.colors.shape == (views, 3, 6, 8)
        assert count or not pictures.alphas.any()
        if pictures.colors.requires_grad:  # also backwards through nothing
            pictures.colors.sum().backward()


@pytest.mark.skipif(_rasterizer is None, reason="the kernels are not built")
@pytest.mark.parametrize("position", range(9))
def test_the_kernels_themselves_refuse_arrays_of_other_sizes(make_scene, position: int):
    gaussians, cameras = make_scene(batch=1, count=5, dtype=torch.float32)
    arrays = [
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh,
        gaussians.anchor_index, cameras.cam_from_world, cameras.intrinsics, torch.zeros(1, 7, 2),
    ]  # fmt: skip
    settings = _rasterizer.Settings(8, 8, 0.05, 100.0, 0.3, 1 / 255, 0.99, 1e-4, 0.0, 0.0, 0.0)
    _, *images = _rasterizer.forward(*arrays, settings, "auto", 1)
    assert images[0].shape == (1, 2, 3, 8, 8)
    # Of one scene fewer than the others: every array has a first axis of scenes.
    wrong = [array[:0] if k == position else array for k, array in enumerate(arrays)]
    with pytest.raises(ValueError, match="has the shape"):
        _rasterizer.forward(*wrong, settings, "auto", 1)
    cut = [a[..., :1].contiguous() if k == position else a for k, a in enumerate(arrays)]
    if position not in (3, 5, 8):  # their last axis is that of Gaussians, or may have any length
        with pytest.raises(ValueError, match="has the shape"):
            _rasterizer.forward(*cut, settings, "auto", 1)


@pytest.mark.skipif(_rasterizer is None, reason="the kernels are not built")
def test_a_frame_of_another_scene_is_refused_in_the_backward_pass(make_scene):
    def arrays(count: int, size: int) -> tuple[list, object]:
        gaussians, cameras = make_scene(batch=1, count=count, dtype=torch.float32)
        settings = _rasterizer.Settings(
            size, size, 0.05, 100.0, 0.3, 1 / 255, 0.99, 1e-4, 0.0, 0.0, 0.0
        )
        return [
            gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh,
            gaussians.anchor_index, cameras.cam_from_world, cameras.intrinsics, None,
        ], settings  # fmt: skip

    inputs, settings = arrays(5, 8)
    frame, *images = _rasterizer.forward(*inputs, settings, "auto", 1)
    gradient = torch.ones(1, 2, 3, 8, 8)
    for other in (arrays(6, 8), arrays(5, 80), arrays(5, 9)):
        drawn = _rasterizer.forward(*other[0], other[1], "auto", 1)[1:]
        with pytest.raises(ValueError, match="the frame was drawn from inputs of other sizes"):
            _rasterizer.backward(
                frame, *other[0], other[1], *drawn, gradient, None, None, None, "auto", 1
            )
    with pytest.raises(ValueError, match=r"color_grads has the shape \(1, 2, 3, 4, 8\)"):
        _rasterizer.backward(
            frame, *inputs, settings, *images, gradient[..., :4, :].contiguous(), None, None, None,
            "auto", 1,
        )  # fmt: skip


def sized_arrays(make_scene, *, scenes=1, views=2, degree=1, anchors=7, channels=2) -> list:
    """What the kernels take before the settings; no features where channels is None."""
    gaussians, cameras = make_scene(
        batch=scenes, views=views, count=5, anchors=3, degree=degree, dtype=torch.float32
    )
    features = torch.zeros(scenes, anchors, channels) if channels is not None else None
    return [
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh,
        gaussians.anchor_index, cameras.cam_from_world, cameras.intrinsics, features,
    ]  # fmt: skip


@pytest.mark.skipif(_rasterizer is None, reason="the kernels are not built")
@pytest.mark.parametrize(
    "other",
    [
        {"scenes": 2}, {"views": 3}, {"degree": 0}, {"anchors": 3}, {"channels": 3},
        {"channels": None},
    ],
    ids=str,
)  # fmt: skip
def test_a_frame_drawn_from_other_sizes_is_refused_in_the_backward_pass(make_scene, other: dict):
    settings = _rasterizer.Settings(8, 8, 0.05, 100.0, 0.3, 1 / 255, 0.99, 1e-4, 0.0, 0.0, 0.0)
    arrays = sized_arrays(make_scene)
    _, *images = _rasterizer.forward(*arrays, settings, "auto", 1)
    frame, *_ = _rasterizer.forward(*sized_arrays(make_scene, **other), settings, "auto", 1)
    with pytest.raises(ValueError, match="the frame was drawn from inputs of other sizes"):
        _rasterizer.backward(
            frame, *arrays, settings, *images, None, None, None, torch.ones(1, 2, 2, 8, 8), "auto",
            1,
        )  # fmt: skip


@pytest.mark.skipif(_rasterizer is None, reason="the kernels are not built")
@pytest.mark.parametrize("number", [-1, 7, 2**40])
@pytest.mark.parametrize("threads", [1, 2])
def test_the_kernels_themselves_refuse_an_anchor_without_features(
    make_scene, number: int, threads: int
):
    settings = _rasterizer.Settings(8, 8, 0.05, 100.0, 0.3, 1 / 255, 0.99, 1e-4, 0.0, 0.0, 0.0)
    arrays = sized_arrays(make_scene)
    arrays[5][0, 4] = number
    with pytest.raises(IndexError, match="anchor_index has a number without a row"):
        _rasterizer.forward(*arrays, settings, "auto", threads)


@pytest.mark.skipif(_rasterizer is None, reason="the kernels are not built")
def test_the_kernels_refuse_lengths_that_their_numbers_cannot_count(make_scene):
    gaussians, cameras = make_scene(batch=1, count=0, dtype=torch.float32)
    arrays = [
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh,
        gaussians.anchor_index, cameras.cam_from_world, cameras.intrinsics,
    ]  # fmt: skip

    def draw(features, height, width):
        settings = _rasterizer.Settings(
            height, width, 0.05, 100.0, 0.3, 1 / 255, 0.99, 1e-4, 0.0, 0.0, 0.0
        )
        _rasterizer.forward(*arrays, features, settings, "auto", 1)

    with pytest.raises(ValueError, match="channels are 2097152, the kernels take at most 1048576"):
        draw(torch.zeros(1, 0, 2**21), 8, 8)
    with pytest.raises(ValueError, match="columns of a picture are 16777217"):
        draw(None, 1, 2**24 + 1)
    with pytest.raises(ValueError, match="pixels of a picture are"):
        draw(None, 2**20, 2**20)
