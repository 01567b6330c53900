"""The rasterizer in C++ for the processor: float32, all scenes and views in one parallel call.

The result does not depend on the number of threads, bit for bit. A process that was forked from
one that had rendered uses one thread, because a pool of threads does not survive a fork.
"""

from dataclasses import dataclass
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from instok3d.render.settings import RasterSettings
from instok3d.types import Cameras, Gaussians, Rendering

try:  # after torch, so that both use torch's OpenMP and its pool of threads
    from instok3d.render.native import _rasterizer  # pyright: ignore[reportAttributeAccessIssue]

    _import_error = None
except ImportError as error:
    _rasterizer = None
    _import_error = str(error)

SMALLEST_ALPHA_MIN = 1e-6
"""Below this, Gaussians have no border that the kernels could use."""

instruction_set = "auto"
"""Which kernels run: "auto" (the best that the processor has), or one of `instruction_sets`."""


@dataclass(frozen=True)
class NativeStatus:
    """Whether the C++ kernels can be used here, and how."""

    available: bool
    instruction_sets: tuple[str, ...]
    """That this processor can run, the fastest first."""
    threading: str
    """"OpenMP" or "std::thread"; empty without the kernels."""
    reason: str
    """Why the kernels are not available; empty if they are."""


def native_status() -> NativeStatus:
    """Whether the C++ kernels were built and load, for reports."""
    if _rasterizer is None:
        reason = (
            "it was not built when instok3d was installed; install a C++ compiler (GCC, Clang or "
            "clang-cl) and reinstall instok3d"
        )
        if find_spec("instok3d.render.native._rasterizer") is not None:
            reason = f"it was built but does not load: {_import_error}"
        return NativeStatus(False, (), "", reason)
    return NativeStatus(True, tuple(_rasterizer.instruction_sets()), _rasterizer.threading(), "")


def render_native(
    gaussians: Gaussians,
    cameras: Cameras,
    height: int,
    width: int,
    *,
    anchor_features: Float[Tensor, "batch anchor channel"] | None,
    background: Float[Tensor, " 3"],
    near: float,
    far: float,
    settings: RasterSettings,
) -> Rendering:
    """Pictures of a batch of scenes; the arguments are those of `instok3d.render.render`.

    Uses `torch.get_num_threads()` threads.

    Raises:
        RuntimeError: The kernels are not built.
        ValueError: alpha_min is below 1e-6, or an anchor index has no row of features.
    """
    if _rasterizer is None:
        raise RuntimeError(f"the native rasterizer is missing: {native_status().reason}")
    if settings.alpha_min < SMALLEST_ALPHA_MIN:
        raise ValueError(
            f"alpha_min is {settings.alpha_min}; the native rasterizer needs at least "
            f'{SMALLEST_ALPHA_MIN}: use backend="reference"'
        )
    red, green, blue = background.tolist()
    native_settings = _rasterizer.Settings(
        height, width, near, far, settings.eps2d, settings.alpha_min, settings.alpha_max,
        settings.transmittance_min, red, green, blue,
    )  # fmt: skip
    features = anchor_features
    if features is not None and features.shape[-1] == 0:
        features = None
    colors, alphas, depths, maps = _Rasterize.apply(
        native_settings, gaussians.anchor_index.contiguous(), cameras.intrinsics.contiguous(),
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh,
        cameras.cam_from_world, features,
    )  # fmt: skip
    if anchor_features is not None and maps is None:
        maps = colors.new_zeros(*colors.shape[:2], 0, height, width)
    return Rendering(colors, alphas, depths, maps)


class _Rasterize(torch.autograd.Function):
    """Colours, alphas, depths and maps of (means, quats, scales, opacities, sh, camera, features).

    The gradient is not differentiable again.
    """

    @staticmethod
    def forward(
        ctx: Any, settings: Any, anchor_index: Tensor, intrinsics: Tensor, *inputs: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor | None]:
        module: ModuleType = _rasterizer  # pyright: ignore[reportAssignmentType]
        kept = [None if value is None else value.detach().contiguous() for value in inputs]
        means, quats, scales, opacities, sh, cam_from_world, features = kept
        arrays = (means, quats, scales, opacities, sh, anchor_index, cam_from_world)
        arrays = (*arrays, intrinsics.detach(), features, settings)
        try:
            frame, *images = module.forward(*arrays, instruction_set, torch.get_num_threads())
        except IndexError as error:
            raise ValueError(str(error)) from error
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(anchor_index, intrinsics, *kept, *images)
        ctx.settings, ctx.frame, ctx.instruction_set = settings, frame, instruction_set
        return tuple(images)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:  # pyright: ignore
        module: ModuleType = _rasterizer  # pyright: ignore[reportAssignmentType]
        if all(grad is None for grad in grads):
            return (None,) * 10
        anchor_index, intrinsics, *saved = ctx.saved_tensors
        means, quats, scales, opacities, sh, cam_from_world, features = saved[:7]
        results = module.backward(
            ctx.frame, means, quats, scales, opacities, sh, anchor_index, cam_from_world,
            intrinsics.detach(), features, ctx.settings, *saved[7:],
            *(None if grad is None else grad.contiguous() for grad in grads),
            ctx.instruction_set, torch.get_num_threads(),
        )  # fmt: skip
        return None, None, None, *results
