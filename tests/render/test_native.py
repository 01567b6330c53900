import importlib.util
import multiprocessing

import pytest
import torch

import patience
from instok3d.geometry.cameras import rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.render import RasterSettings, native_backend, native_status, render
from instok3d.types import Cameras, Gaussians, Rendering

STATUS = native_status()
if not STATUS.available:
    pytest.skip(f"no native rasterizer: {STATUS.reason}", allow_module_level=True)

BACKGROUND = (0.1, 0.2, 0.3)


@pytest.fixture(autouse=True)
def _as_before():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)
    native_backend.instruction_set = "auto"


def images(out: Rendering) -> dict[str, torch.Tensor]:
    return {name: value for name, value in vars(out).items() if value is not None}


def run(gaussians, cameras, height, width, features=None, *, backend, grads=None, **options):
    """Images, and the gradients of everything for random (or the given) gradients of the images."""
    dtype = torch.float64 if backend == "reference" else torch.float32
    leaves = {
        name: value.to(dtype).clone().requires_grad_()
        for name, value in vars(gaussians).items()
        if value.is_floating_point()
    }
    leaves["cam_from_world"] = cameras.cam_from_world.to(dtype).clone().requires_grad_()
    if features is not None:
        leaves["features"] = features.to(dtype).clone().requires_grad_()
    scene = {name: leaves.get(name, value) for name, value in vars(gaussians).items()}
    out = images(
        render(
            Gaussians(**scene), Cameras(leaves["cam_from_world"], cameras.intrinsics), height,
            width, anchor_features=leaves.get("features"), background=BACKGROUND,
            backend=backend, **options,
        )
    )  # fmt: skip
    if grads is None:
        generator = torch.Generator().manual_seed(1)
        grads = {k: torch.randn(v.shape, generator=generator) for k, v in out.items()}
    total = sum((out[name] * grad.to(dtype)).sum() for name, grad in grads.items())
    found = torch.autograd.grad(total, list(leaves.values()), allow_unused=True)
    return (
        {k: v.detach() for k, v in out.items()},
        {
            name: torch.zeros_like(leaf) if grad is None else grad
            for (name, leaf), grad in zip(leaves.items(), found, strict=True)
        },
    )


def assert_near(actual, expected, *, tolerance):
    """All but 1 % within the tolerance of the largest value; nowhere more than a flipped threshold.

    An alpha near 1/255 or a transmittance near 1e-4 may fall on either side in float32, which
    moves a pixel by up to 1/255; no implementation in float32 is free of it.
    """
    for name, value in expected.items():
        assert actual[name].shape == value.shape
        assert actual[name].isfinite().all(), name
        if not value.numel():
            continue
        error = (actual[name].double() - value).abs().flatten()
        scale = value.abs().max().clamp_min(1e-12)
        error = (error / scale).sort().values
        assert error[int(0.99 * (len(error) - 1))] <= tolerance, (name, error[-5:])
        assert error[-1] <= 0.02, name


CASES = [
    {"height": 40, "width": 56, "degree": 3, "channels": 7},
    {"height": 17, "width": 33, "degree": 2, "channels": 1},
    {"height": 33, "width": 16, "degree": 1, "channels": 33},
    {"height": 1, "width": 1, "degree": 0, "channels": 5},
    {"height": 32, "width": 48, "degree": 0, "channels": 100},
    {"height": 20, "width": 30, "degree": 2, "channels": 0},
    {"height": 48, "width": 32, "degree": 3, "channels": None},
]


@pytest.mark.parametrize("instruction_set", STATUS.instruction_sets)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_values_and_gradients_are_those_of_the_reference(make_scene, rng, case, instruction_set):
    height, width, channels = case["height"], case["width"], case["channels"]
    gaussians, cameras = make_scene(
        batch=2, count=200, anchors=11, degree=case["degree"], height=height, width=width
    )
    features = None
    if channels is not None:
        features = torch.randn(2, 11, channels, generator=rng, dtype=torch.float64)
    native_backend.instruction_set = instruction_set
    expected = run(gaussians, cameras, height, width, features, backend="reference")
    actual = run(gaussians, cameras, height, width, features, backend="native")
    assert_near(actual[0], expected[0], tolerance=2e-5)
    assert_near(actual[1], expected[1], tolerance=5e-5)


def test_gradients_of_more_gaussians_than_a_task_takes_are_those_of_the_reference(make_scene):
    gaussians, cameras = make_scene(count=2100, degree=1, height=12, width=16)
    expected = run(gaussians, cameras, 12, 16, backend="reference")
    actual = run(gaussians, cameras, 12, 16, backend="native")
    assert_near(actual[1], expected[1], tolerance=5e-5)


def test_gradient_of_one_image_alone_is_that_of_the_reference(make_scene, rng):
    gaussians, cameras = make_scene(count=100, height=24, width=32)
    features = torch.randn(7, 3, generator=rng, dtype=torch.float64)
    for name in ("colors", "alphas", "depths", "features"):
        shape = {"colors": (3,), "features": (3,)}.get(name, ())
        grads = {name: torch.randn(2, *shape, 24, 32, generator=rng)}
        expected = run(gaussians, cameras, 24, 32, features, backend="reference", grads=grads)
        actual = run(gaussians, cameras, 24, 32, features, backend="native", grads=grads)
        assert_near(actual[1], expected[1], tolerance=5e-5)


def test_other_thresholds_and_planes_are_those_of_the_reference(make_scene):
    gaussians, cameras = make_scene(count=200)
    options = {
        "settings": RasterSettings(
            eps2d=0.1, alpha_min=0.02, alpha_max=0.8, transmittance_min=0.01
        ),
        "near": 2.5,
        "far": 3.4,
    }  # fmt: skip
    expected = run(gaussians, cameras, 24, 32, backend="reference", **options)
    actual = run(gaussians, cameras, 24, 32, backend="native", **options)
    assert_near(actual[0], expected[0], tolerance=2e-5)
    assert_near(actual[1], expected[1], tolerance=5e-5)


@pytest.mark.parametrize("batch", [None, 3])
def test_the_number_of_threads_changes_no_bit(make_scene, rng, batch):
    gaussians, cameras = make_scene(batch=batch, count=3000, anchors=50, height=70, width=50)
    lead = () if batch is None else (batch,)
    features = torch.randn(*lead, 50, 20, generator=rng, dtype=torch.float64)
    torch.set_num_threads(1)
    expected = run(gaussians, cameras, 70, 50, features, backend="native")
    for threads in (2, 3):
        torch.set_num_threads(threads)
        actual = run(gaussians, cameras, 70, 50, features, backend="native")
        for before, after in zip(expected, actual, strict=True):
            assert all(torch.equal(before[name], after[name]) for name in before)


def test_a_batch_is_its_scenes_one_by_one_bit_for_bit(make_scene, rng):
    gaussians, cameras = make_scene(batch=2, count=150)
    features = torch.randn(2, 7, 4, generator=rng, dtype=torch.float64)
    both = run(gaussians, cameras, 24, 32, features, backend="native")
    shapes = {name: value[0].shape for name, value in both[0].items()}
    generator = torch.Generator().manual_seed(1)
    grads = {k: torch.randn(2, *shape, generator=generator) for k, shape in shapes.items()}
    for scene in range(2):
        alone = run(
            Gaussians(**{k: v[scene] for k, v in vars(gaussians).items()}),
            Cameras(cameras.cam_from_world[scene], cameras.intrinsics[scene]),
            24, 32, features[scene], backend="native",
            grads={name: value[scene] for name, value in grads.items()},
        )  # fmt: skip
        for together, single in zip(both, alone, strict=True):
            assert all(torch.equal(together[name][scene], single[name]) for name in together)


POISON = {
    "mean nan": ("means", torch.nan),
    "mean infinite": ("means", torch.inf),
    "quaternion nan": ("quats", torch.nan),
    "quaternion infinite": ("quats", -torch.inf),
    "scale nan": ("scales", torch.nan),
    "scale infinite": ("scales", torch.inf),
    "opacity nan": ("opacities", torch.nan),
    "opacity infinite": ("opacities", torch.inf),
    "colour nan": ("sh", torch.nan),
    "colour infinite": ("sh", -torch.inf),
}


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_a_gaussian_with_a_non_finite_number_is_as_if_it_were_not_there(make_scene, rng, backend):
    gaussians, cameras = make_scene(count=len(POISON) + 40)
    features = torch.randn(7, 3, generator=rng, dtype=torch.float64)
    for row, (name, value) in enumerate(POISON.values()):
        getattr(gaussians, name)[row].view(-1)[-1] = value
    bad = len(POISON)
    without = Gaussians(**{name: value[bad:] for name, value in vars(gaussians).items()})
    expected = run(without, cameras, 24, 32, features, backend=backend)
    actual = run(gaussians, cameras, 24, 32, features, backend=backend)
    torch.testing.assert_close(actual[0], expected[0])
    for name, value in expected[1].items():
        found = actual[1][name]
        if name not in ("cam_from_world", "features"):
            assert found[:bad].count_nonzero() == 0
            found = found[bad:]
        torch.testing.assert_close(found, value)


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_a_nan_at_any_place_is_one_gaussian_less(make_scene, backend):
    gaussians, cameras = make_scene(count=60, degree=1)
    places = [
        (name, column)
        for name, value in vars(gaussians).items()
        if value.is_floating_point()
        for column in range(value[0].numel())
    ]
    for row, (name, column) in enumerate(places):
        getattr(gaussians, name)[row].view(-1)[column] = torch.nan
    expected = run(gaussians.rows(slice(len(places), None)), cameras, 24, 32, backend=backend)
    actual = run(gaussians, cameras, 24, 32, backend=backend)
    torch.testing.assert_close(actual[0], expected[0])
    assert all(grad.isfinite().all() for grad in actual[1].values())


def test_a_second_derivative_is_refused(make_scene):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    gaussians.means.requires_grad_()
    picture = render(gaussians, cameras, 8, 8, backend="native").colors
    (gradient,) = torch.autograd.grad(picture.square().sum(), gaussians.means, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_nothing_to_see_is_the_background_with_zero_gradients(make_scene, rng, backend):
    gaussians, cameras = make_scene(count=30)
    features = torch.randn(7, 3, generator=rng, dtype=torch.float64)
    behind = Gaussians(**{**vars(gaussians), "means": gaussians.means - torch.tensor([0, 0, 20.0])})
    none = Gaussians(**{name: value[:0] for name, value in vars(gaussians).items()})
    for scene in (behind, none):
        out, grads = run(scene, cameras, 24, 32, features, backend=backend)
        background = torch.tensor(BACKGROUND, dtype=out["colors"].dtype)
        assert torch.equal(out["colors"], background.view(3, 1, 1).expand(2, 3, 24, 32))
        assert all(out[name].count_nonzero() == 0 for name in ("alphas", "depths", "features"))
        assert all(grad.count_nonzero() == 0 for grad in grads.values())


def test_extreme_gaussians_give_finite_numbers(make_scene):
    gaussians, cameras = make_scene(count=60)
    gaussians.quats[0] = 0
    gaussians.scales[1] = 1e6
    gaussians.scales[2] = 1e-12
    gaussians.scales[3] = torch.tensor([1e-9, 3.0, 1e4])
    gaussians.scales[4] = 1e15
    gaussians.means[5, 2] = 0.0500001
    gaussians.means[6] = torch.tensor([1e6, -1e6, 3.0])
    gaussians.opacities[7] = 1.0
    gaussians.sh[8] = 1e6
    out, grads = run(gaussians, cameras, 24, 32, backend="native")
    for value in (*out.values(), *grads.values()):
        assert value.isfinite().all()


def test_a_scene_of_the_authors_is_that_of_the_reference(shared):
    path = shared / "prototypes" / "raster" / "scenes.py"
    spec = importlib.util.spec_from_file_location("scenes", path)
    assert spec is not None
    assert spec.loader is not None
    scenes = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scenes)
    s = scenes.build(scenes.SCENES[0], K=80, Ng=16, W=64, H=48, L=20)
    gaussians = Gaussians(
        means=torch.tensor(s["means"]).double(),
        quats=torch.tensor(s["quats"]).double(),
        scales=torch.tensor(s["scales"]).double(),
        opacities=torch.tensor(s["opac"]).double(),
        sh=((torch.tensor(s["rgb"]).double() - 0.5) / 0.28209479177387814)[:, None],
        anchor_index=torch.tensor(s["anchor"]).long(),
    )
    intrinsics = torch.tensor([[s["fx"], 0, s["cx"]], [0, s["fy"], s["cy"]], [0, 0, 1]]).double()
    turn = quat_to_matrix(torch.tensor([1.0, 0.0, 0.05, 0.0], dtype=torch.float64))
    shift = torch.tensor([0.05, -0.1, 0.2], dtype=torch.float64)
    cameras = Cameras(rigid(turn, shift)[None], intrinsics[None])
    features = torch.tensor(s["pi"]).double()
    expected = run(gaussians, cameras, 48, 64, features, backend="reference")
    actual = run(gaussians, cameras, 48, 64, features, backend="native")
    assert_near(actual[0], expected[0], tolerance=2e-5)
    # Quaternions of needles have larger errors in any float32 implementation.
    assert_near(actual[1], expected[1], tolerance=1e-4)


def test_half_precision_and_autocast_are_rendered_in_float32(make_scene):
    gaussians, cameras = make_scene(count=50)
    half = Gaussians(
        **{k: v.bfloat16() if v.is_floating_point() else v for k, v in vars(gaussians).items()}
    )
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = render(half, cameras, 24, 32)
    assert inside.colors.dtype == torch.float32
    single = Gaussians(
        **{k: v.float() if v.is_floating_point() else v for k, v in vars(half).items()}
    )
    torch.testing.assert_close(inside.colors, render(single, cameras, 24, 32).colors)


def _render_in_child(gaussians, cameras):
    render(gaussians, cameras, 24, 32, backend="native")


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_renders(make_scene):
    gaussians, cameras = make_scene(count=20, dtype=torch.float32)
    torch.set_num_threads(2)
    render(gaussians, cameras, 24, 32, backend="native")
    child = multiprocessing.get_context("fork").Process(
        target=_render_in_child, args=(gaussians, cameras)
    )
    child.start()
    child.join(patience.SECONDS)
    hangs = child.is_alive()
    child.kill()
    assert not hangs
    assert child.exitcode == 0


def test_what_the_kernels_cannot_do_is_refused(make_scene):
    gaussians, cameras = make_scene(count=5, dtype=torch.float32)
    with pytest.raises(ValueError, match=r"alpha_min is 0\.0"):
        render(gaussians, cameras, 8, 8, settings=RasterSettings(alpha_min=0.0), backend="native")
    with pytest.raises(ValueError, match="number without a row"):
        render(gaussians, cameras, 8, 8, anchor_features=torch.zeros(2, 3))
    gaussians, cameras = make_scene(count=5)
    with pytest.raises(ValueError, match="float32"):
        render(gaussians, cameras, 8, 8, backend="native")
