"""The data that flows through InsTok3D: one frozen dataclass for each stage, in order.

Photos (`Views`) -> `Geometry` (features and pointmaps) -> `Context` (one token a patch)
-> `Anchors` -> `TokenGroups` (groups, assignment, `Gaussians`) -> `Rendering`.

OpenCV axes (x right, y down, z forward), intrinsics in pixels of the image they come with,
the centre of the top-left pixel is (0.5, 0.5), quaternions wxyz, colours sRGB in [0, 1].
The world is the frame of the first view's camera unless a field says otherwise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

# Not typing.Self: the run-time checks of the tests do not know it outside of decorated classes.
AnyFlow = TypeVar("AnyFlow", bound="Flow")
AnyScenes = TypeVar("AnyScenes", bound="Scenes")


@dataclass(frozen=True)
class Flow:
    """Base of the stages below: operations on all the tensors of one at once."""

    def __init_subclass__(cls) -> None:
        # Set before @dataclass sets its own, which writes the numbers of all tensors.
        cls.__repr__ = Flow.__repr__

    def __repr__(self) -> str:
        fields = [f"{name}={_summary(value)}" for name, value in vars(self).items()]
        return f"{type(self).__name__}({', '.join(fields)})"

    def map(self: AnyFlow, operation: Callable[[Tensor], Tensor]) -> AnyFlow:
        """The stage with an operation applied to every tensor, nested stages included."""
        return type(self)(**{name: _mapped(value, operation) for name, value in vars(self).items()})

    def to(self: AnyFlow, *args: Any, **kwargs: Any) -> AnyFlow:
        """The stage on a device, as `Tensor.to`."""
        return self.map(lambda tensor: tensor.to(*args, **kwargs))

    @classmethod
    def concatenate(cls: type[AnyFlow], parts: Sequence[AnyFlow], axis: int = 0) -> AnyFlow:
        """Several stages of one kind as one, every tensor joined along an axis, in order.

        Indices in them, such as anchor_index, stay as they are.

        Raises:
            ValueError: No part, from which the other sizes would follow.
        """
        if not parts:
            raise ValueError("nothing to concatenate: at least one part is needed, it may be empty")
        fields = {name: [vars(part)[name] for part in parts] for name in vars(parts[0])}
        return cls(**{name: _concatenated(values, axis) for name, values in fields.items()})


@dataclass(frozen=True)
class Scenes(Flow):
    """Base of stages that exist for one scene and for a batch of scenes."""

    def scene(self: AnyScenes, index: int) -> AnyScenes:
        """One scene of a batch, without the batch axis."""
        return self.map(lambda tensor: tensor[index])

    def batched(self: AnyScenes) -> AnyScenes:
        """One scene as a batch of one."""
        return self.map(lambda tensor: tensor[None])


def _concatenated(values: list[Any], axis: int) -> Any:
    first = values[0]
    if first is None:
        return None
    return first.concatenate(values, axis) if isinstance(first, Flow) else torch.cat(values, axis)


def _summary(value: Any) -> str:
    if not isinstance(value, Tensor):
        return repr(value)
    return f"{str(value.dtype).removeprefix('torch.')}{list(value.shape)}"


def _mapped(value: Any, operation: Callable[[Tensor], Tensor]) -> Any:
    if isinstance(value, Flow):
        return value.map(operation)
    return None if value is None else operation(value)


@dataclass(frozen=True)
class Cameras(Scenes):
    """Where views stand and how they project."""

    cam_from_world: Float[Tensor, "*batch view 4 4"]
    """Rigid transforms that take world points into each camera's frame."""
    intrinsics: Float[Tensor, "*batch view 3 3"]
    """Pixels of the image that is rendered or that was taken."""

    def view(self, index: int) -> "Cameras":
        """The camera of one view; the view axis stays, of length 1. A negative index is refused.

        Raises:
            IndexError: There is no such view.
        """
        count = self.intrinsics.shape[-3]
        if not 0 <= index < count:
            raise IndexError(f"no view {index}; there are {count}, counted from 0")
        return self.views([index])

    def views(self, indices: Sequence[int]) -> "Cameras":
        """The cameras of some views, in the order of the indices."""
        return self.map(lambda tensor: tensor[..., list(indices), :, :])


@dataclass(frozen=True)
class Views(Flow):
    """Photos of one scene each, with cameras and depth where they are known."""

    images: Float[Tensor, "batch view 3 height width"]
    """sRGB in [0, 1]."""
    intrinsics: Float[Tensor, "batch view 3 3"] | None = None
    """Of these images at this size; None when unknown."""
    cam_from_world: Float[Tensor, "batch view 4 4"] | None = None
    """Any world frame; None for unposed photos."""
    depths: Float[Tensor, "batch view height width"] | None = None
    """z-depth in the units of cam_from_world, 0 where it is unknown; None without a sensor."""


@dataclass(frozen=True)
class Geometry(Flow):
    """What a geometry backbone says of the views. World = the first view's camera."""

    features: Float[Tensor, "batch view patch channel"]
    """F: multi-view features, patches in row-major order."""
    depths: Float[Tensor, "batch view height width"]
    """z-depth in each view's own camera, scene units, > 0."""
    pointmaps: Float[Tensor, "batch view height width 3"]
    """P: the 3D point behind every pixel, in the first camera's frame, scene units."""
    confidences: Float[Tensor, "batch view height width"]
    """> 0; larger is surer."""
    cameras: Cameras
    """cam_from_world with the first camera as the world (its matrix is the identity)."""


@dataclass(frozen=True)
class Context(Flow):
    """X: one token for each patch of every view, with where the patch lies and how it looks."""

    tokens: Float[Tensor, "batch patch channel"]
    """X. Patches of view 0 first, row-major within a view."""
    positions: Float[Tensor, "batch patch 3"]
    """P~: the pointmap at the patch centres, in units of scale."""
    cells: Float[Tensor, "batch patch cell 6"]
    """Surface point (xyz, in units of scale) and colour (rgb) of each sub-cell of the patch,
    row-major: where and in which colour a Gaussian head may start its Gaussians."""
    scale: Float[Tensor, " batch"]
    """Scene units in one unit of the positions: the mean distance of the pointmaps, or 1 where
    the tokenizer takes scenes as they are."""


@dataclass(frozen=True)
class Anchors(Flow):
    """Anchor tokens and where they stand."""

    positions: Float[Tensor, "batch anchor 3"]
    """a_k, in units of the context's scale."""
    tokens: Float[Tensor, "batch anchor channel"]
    """A_k (or the seeds A0 before the decoder)."""
    patches: Int[Tensor, "batch anchor"]
    """Which patch of the context each anchor was placed on."""
    lifted: Float[Tensor, "batch anchor channel"] | None = None
    """Anchor semantic tokens (Sec. 3.3), where 2D features were lifted."""


@dataclass(frozen=True)
class Gaussians(Scenes):
    """3D Gaussians in world space, named and stored as gsplat takes them."""

    means: Float[Tensor, "*batch gaussian 3"]
    """Centres, scene units."""
    quats: Float[Tensor, "*batch gaussian 4"]
    """Rotations, wxyz, unit length."""
    scales: Float[Tensor, "*batch gaussian 3"]
    """Standard deviations along the principal axes, scene units, > 0."""
    opacities: Float[Tensor, "*batch gaussian"]
    """In [0, 1]."""
    sh: Float[Tensor, "*batch gaussian coefficient 3"]
    """Colour; (degree + 1)^2 coefficients, number 0 is the constant term."""
    anchor_index: Int[Tensor, "*batch gaussian"]
    """The anchor that each Gaussian was decoded from: the row of per-anchor features."""

    def rows(
        self, which: slice | Bool[Tensor, " gaussian"] | Int[Tensor, " chosen"]
    ) -> "Gaussians":
        """Some Gaussians of one scene (no batch axis), by a slice, a mask or indices."""
        return self.map(lambda tensor: tensor[which])


MAX_LENGTH = 1e9
"""Of scales and coordinates; fourth powers of it are still finite in single precision."""


def check_gaussians(gaussians: Gaussians, where: object) -> None:
    """Refuse Gaussians that cannot be drawn.

    Args:
        gaussians: Of one scene or of a batch.
        where: The file or object that holds them, the subject of the message.

    Raises:
        ValueError: A value is not finite, a centre or scale is beyond MAX_LENGTH, a scale is not
            above 0, an opacity is outside [0, 1], a quaternion is not of unit length, there are
            not 1, 4, 9 or 16 colour coefficients, or an anchor_index is negative.
    """
    sound = {
        "means": gaussians.means.abs() <= MAX_LENGTH,
        "quats": (gaussians.quats.norm(dim=-1) - 1).abs() <= 1e-3,
        "scales": (gaussians.scales > 0) & (gaussians.scales <= MAX_LENGTH),
        "opacities": (gaussians.opacities >= 0) & (gaussians.opacities <= 1),
        "sh": gaussians.sh.isfinite(),
        "anchor_index": gaussians.anchor_index >= 0,
    }
    wanted = {
        "means": f"finite numbers within {MAX_LENGTH:.0e}",
        "quats": "quaternions of unit length",
        "scales": f"lengths above 0 and within {MAX_LENGTH:.0e}",
        "opacities": "numbers in [0, 1]",
        "sh": "finite numbers",
        "anchor_index": "row numbers",
    }
    for name, good in sound.items():
        if not good.all():
            count = int((~good).sum())
            raise ValueError(f"{where} has {count} values in {name} that are no {wanted[name]}")
    if gaussians.sh.shape[-2] not in (1, 4, 9, 16):
        raise ValueError(
            f"{where} has {gaussians.sh.shape[-2]} colour coefficients in sh, wanted 1, 4, 9 or 16"
        )


@dataclass(frozen=True)
class TokenGroups(Flow):
    """What the tokenizer returns: a scene as anchors, groups, and which anchor is whose."""

    anchors: Anchors
    """A and a; positions in scene units, in the first camera's frame."""
    tokens: Float[Tensor, "batch group channel"]
    """G_l."""
    assignment: Float[Tensor, "batch anchor group+1"]
    """pi_kl; the last column is the void; rows sum to 1."""
    gaussians: Gaussians
    """N_g for each anchor, in anchor order, scene units, first camera's frame."""
    geometry: Geometry
    """The backbone's geometry that the tokens were built from."""


@dataclass(frozen=True)
class Rendering(Scenes):
    """Pictures of Gaussians."""

    colors: Float[Tensor, "*batch view 3 height width"]
    """sRGB, not clamped above; the background is composited behind."""
    alphas: Float[Tensor, "*batch view height width"]
    """Coverage in [0, 1]."""
    depths: Float[Tensor, "*batch view height width"]
    """Expected z-depth, sum(w z) / sum(w), scene units; 0 where nothing was hit."""
    features: Float[Tensor, "*batch view channel height width"] | None = None
    """Composited per-anchor features (Sec. 3.2), not divided by alpha; None when not asked for."""
