"""The one call that renders, and the choice of the backend behind it."""

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.render.reference import render_reference
from instok3d.render.settings import RasterSettings
from instok3d.types import Cameras, Gaussians, Rendering

Backend = Literal["auto", "native", "reference", "gsplat"]


def render(
    gaussians: Gaussians,
    cameras: Cameras,
    height: int,
    width: int,
    *,
    anchor_features: Float[Tensor, "*batch anchor channel"] | None = None,
    background: Float[Tensor, " 3"] | Sequence[float] = (0.0, 0.0, 0.0),
    near: float = 0.05,
    far: float = 100.0,
    settings: RasterSettings = RasterSettings(),  # noqa: B008 - frozen
    backend: Backend = "auto",
) -> Rendering:
    """Pictures of one scene or of a batch of scenes, every view of all of them in one call.

    Differentiable in means, scales, quats, opacities, sh, anchor_features and cam_from_world;
    not in the intrinsics or the background. Gaussians with a NaN or an infinity anywhere are
    not drawn and have zero gradients.

    Args:
        gaussians: With one leading batch axis or without.
        cameras: With the same leading batch axis, or without.
        height: Of the pictures, pixels.
        width: Of the pictures, pixels.
        anchor_features: Composited through the anchors that the Gaussians came from (Eq. 4);
            group probabilities, for example.
        background: sRGB colour behind everything.
        near: Gaussians whose mean is nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
        settings: Thresholds.
        backend: "auto" takes gsplat for CUDA tensors, else the native kernels where they are
            built and the tensors are float32, else the PyTorch reference.

    Raises:
        ValueError: Sizes that do not fit together, or an anchor index without a feature row.
    """
    batched = gaussians.means.ndim == 3
    if not batched:
        gaussians = Gaussians(**{name: value[None] for name, value in vars(gaussians).items()})
        cameras = Cameras(cameras.cam_from_world[None], cameras.intrinsics[None])
        anchor_features = anchor_features[None] if anchor_features is not None else None
    background = torch.as_tensor(
        background, dtype=gaussians.means.dtype, device=gaussians.means.device
    )
    rendering = render_reference(
        gaussians, cameras, height, width, anchor_features=anchor_features,
        background=background, near=near, far=far, settings=settings,
    )  # fmt: skip
    if batched:
        return rendering
    features = rendering.features[0] if rendering.features is not None else None
    return Rendering(rendering.colors[0], rendering.alphas[0], rendering.depths[0], features)
