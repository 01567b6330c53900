"""The C++ kernel of exact search; what it does in PyTorch stands beside its use."""

from types import ModuleType

import torch  # noqa: F401  before the kernel, so that both share torch's OpenMP and its threads

try:
    from instok3d.library.native import _search  # pyright: ignore[reportAttributeAccessIssue]
except ImportError:
    _search = None

kernel: ModuleType | None = _search
"""None where it was not built with instok3d."""
