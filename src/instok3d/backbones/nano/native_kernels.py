"""The C++ kernels of this backbone; each has a reference in PyTorch beside it."""

from types import ModuleType

import torch
from torch import Tensor

try:  # after torch, so that both share torch's OpenMP and its thread pool
    from instok3d.backbones.nano.native import (
        _kernels,  # pyright: ignore[reportAttributeAccessIssue]
    )
except ImportError:
    _kernels = None

kernels: ModuleType | None = _kernels
"""None where they were not built with instok3d."""


def kernels_for(*values: Tensor) -> ModuleType | None:
    """The kernels, if they exist and can take these values: float32 on the CPU."""
    fit = all(value.dtype == torch.float32 and value.device.type == "cpu" for value in values)
    return kernels if fit else None


def required_kernels() -> ModuleType:
    """The kernels.

    Raises:
        RuntimeError: They are not built.
    """
    if kernels is None:
        raise RuntimeError("the kernels of the nano backbone were not built with instok3d")
    return kernels
