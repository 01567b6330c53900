"""Reading a safetensors file of weights, which may be damaged or of another network."""

from collections.abc import Callable
from pathlib import Path

from safetensors import safe_open
from torch import Tensor

from instok3d.reading import UNREADABLE, reason_of

FETCH_AGAIN = "fetch it again with `instok3d models pull`"
"""What to do about a damaged file that is in the catalogue."""


def read_weights_file(
    path: Path, remedy: str, *, wanted: Callable[[str], bool] = lambda name: True
) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The weights of a file in float32, all finite, and its metadata.

    Args:
        path: A file that is there.
        remedy: What to do about a damaged one.
        wanted: The names of the tensors to read.

    Raises:
        ValueError: It is not a whole safetensors file, or a weight is not finite.
    """
    try:
        with safe_open(path, framework="pt") as stream:
            names = [name for name in stream.keys() if wanted(name)]  # noqa: SIM118
            weights = {name: stream.get_tensor(name).float() for name in names}
            metadata = dict(stream.metadata() or {})
    except UNREADABLE as error:
        raise ValueError(
            f"{path} is not a whole safetensors file: {reason_of(error)}; {remedy}"
        ) from error
    for name, value in weights.items():
        if not value.isfinite().all():
            raise ValueError(f"{path} has the weight {name}, which is not finite; {remedy}")
    return weights, metadata
