"""What `render` refuses, in one sentence each; behind this door the backends trust all sizes."""

import torch
from torch import Tensor

from instok3d.geometry.spherical_harmonics import sh_degree
from instok3d.types import Cameras, Gaussians

MAX_PIXELS = 2**26
"""Of one picture, 8,192 x 8,192: a larger one is taken for a mistake before memory is asked for."""


def check_picture(height: int, width: int, near: float, far: float) -> None:
    """Refuses pictures without pixels or with too many, and planes that are out of order."""
    if height < 1 or width < 1:
        raise ValueError(f"height and width must be at least 1, got {height} x {width}")
    if height * width > MAX_PIXELS:
        raise ValueError(
            f"a picture of {height} x {width} has more than {MAX_PIXELS} pixels; ask for a "
            "smaller one"
        )
    if not 0 <= near <= far:
        raise ValueError(f"near and far must satisfy 0 <= near <= far, got {near} and {far}")


def check_background(color: Tensor) -> None:
    """Refuses a background that is not one colour."""
    if color.shape != (3,):
        raise ValueError(
            f"background has the shape {tuple(color.shape)}, wanted three numbers: red, green, blue"
        )


def check_scene(gaussians: Gaussians, cameras: Cameras, anchor_features: Tensor | None) -> None:
    """Refuses tensors whose axes, kinds or devices do not fit together."""
    _check_gaussians(gaussians)
    lead = gaussians.means.shape[:-2]
    _check_cameras(cameras, lead)
    if anchor_features is not None and (
        anchor_features.ndim < 2 or anchor_features.shape[:-2] != lead
    ):
        raise ValueError(
            f"anchor_features have the shape {tuple(anchor_features.shape)}; the axes before the "
            f"last two must be {tuple(lead)}, as those of the gaussians"
        )
    _check_kinds(gaussians, cameras, anchor_features)
    if anchor_features is not None:
        _check_anchors(gaussians.anchor_index, anchor_features.shape[-2])


def _check_gaussians(gaussians: Gaussians) -> None:
    means = gaussians.means
    if means.ndim not in (2, 3) or means.shape[-1] != 3:
        raise ValueError(
            f"gaussians.means has the shape {tuple(means.shape)}, wanted (gaussian, 3) or "
            "(batch, gaussian, 3)"
        )
    before = tuple(means.shape[:-1])
    coefficients = gaussians.sh.shape[-2] if gaussians.sh.ndim > 1 else 1
    last = {"quats": (4,), "scales": (3,), "sh": (coefficients, 3)}
    for name, value in vars(gaussians).items():
        wanted = (*before, *last.get(name, ()))
        if name != "means" and value.shape != wanted:
            raise ValueError(
                f"gaussians.{name} has the shape {tuple(value.shape)}, wanted {wanted} with means "
                f"of {tuple(means.shape)}"
            )
    sh_degree(gaussians.sh)


def _check_cameras(cameras: Cameras, lead: torch.Size) -> None:
    for name, side in (("cam_from_world", 4), ("intrinsics", 3)):
        shape = getattr(cameras, name).shape
        fits = len(shape) == len(lead) + 3 and shape[: len(lead)] == lead
        if not fits or shape[-2:] != (side, side):
            wanted = ", ".join([*map(str, lead), "view", str(side), str(side)])
            raise ValueError(
                f"cameras.{name} has the shape {tuple(shape)}, wanted ({wanted}) with "
                f"these gaussians"
            )
    if cameras.intrinsics.shape[-3] != cameras.cam_from_world.shape[-3]:
        raise ValueError(
            f"cameras have {cameras.intrinsics.shape[-3]} intrinsics and "
            f"{cameras.cam_from_world.shape[-3]} cam_from_world; both are one for each view"
        )


def _check_kinds(gaussians: Gaussians, cameras: Cameras, anchor_features: Tensor | None) -> None:
    tensors = [
        *((f"gaussians.{name}", value) for name, value in vars(gaussians).items()),
        *((f"cameras.{name}", value) for name, value in vars(cameras).items()),
    ]
    if anchor_features is not None:
        tensors.append(("anchor_features", anchor_features))
    device = gaussians.means.device
    for name, value in tensors:
        if value.device != device:
            raise ValueError(
                f"{name} lies on {value.device}, gaussians.means on {device}; bring all tensors "
                "to one device"
            )
        if name == "gaussians.anchor_index":
            whole = not (value.is_floating_point() or value.is_complex())
            if not whole or value.dtype == torch.bool:
                raise ValueError(f"{name} is {value.dtype}, wanted whole numbers")
        elif not value.is_floating_point():
            raise ValueError(f"{name} is {value.dtype}, wanted floats")


def _check_anchors(anchor_index: Tensor, num_anchors: int) -> None:
    if not anchor_index.numel():
        return
    low, high = (int(value) for value in anchor_index.aminmax())
    if low < 0 or high >= num_anchors:
        raise ValueError(
            "gaussians.anchor_index has a number without a row of anchor_features: it runs from "
            f"{low} to {high}, and there are {num_anchors} rows, numbered from 0"
        )
