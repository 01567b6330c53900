"""Networks without memory for their weights: for counting and for asking sizes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch.overrides import TorchFunctionMode

from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.cost import Outline
from instok3d.types import Geometry, Views

RANDOM_FILLS = {"normal_", "trunc_normal_", "uniform_", "kaiming_normal_", "kaiming_uniform_"}


@contextmanager
def on_paper() -> Iterator[None]:
    """What is made in this block has shapes and no values (torch's meta device)."""
    with torch.device("meta"), _Unfilled():
        yield


@contextmanager
def without_random_fills() -> Iterator[None]:
    """What is made in this block has weights of any value, to be loaded; the rest is as ever."""
    with _NoRandomFills():
        yield


class _NoRandomFills(TorchFunctionMode):
    """Leaves out random values, unless they come from a generator of their own."""

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        kwargs = kwargs or {}
        if kwargs.get("generator") is None:
            if getattr(func, "__name__", "") in RANDOM_FILLS:
                return args[0] if args else kwargs["tensor"]
            if func in (torch.randn, torch.rand):
                func = torch.empty
        return func(*args, **kwargs)


class _Unfilled(_NoRandomFills):
    """Leaves out all that gives values alone: random ones, and products with a number.

    On the meta device each of these would import 800 modules, 80 MB and some seconds.
    """

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        if func is torch.Tensor.mul and isinstance(args[1], int | float):
            return args[0]
        return super().__torch_function__(func, types, args, kwargs)


class StandIn(GeometryBackbone):
    """Stands in for a backbone where only the tokenizer's own tensors are of interest."""

    def __init__(self, outline: Outline) -> None:
        super().__init__()
        self.patch_size, self.feature_channels = outline.patch_size, outline.feature_channels

    def forward(self, views: Views) -> Geometry:
        """Always fails."""
        raise NotImplementedError("a stand-in for a backbone cannot be run")
