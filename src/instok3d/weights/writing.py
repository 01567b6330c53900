"""A safetensors file written tensor by tensor: 5 GB of weights need the memory of one tensor."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from instok3d.files import replacing

DTYPES = {
    torch.float64: "F64",
    torch.float32: "F32",
    torch.float16: "F16",
    torch.bfloat16: "BF16",
    torch.int64: "I64",
    torch.int32: "I32",
    torch.int16: "I16",
    torch.int8: "I8",
    torch.uint8: "U8",
    torch.bool: "BOOL",
}
"""Names of the element types in the format."""


def write_tensors(
    path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str] | None = None
) -> str:
    """Write tensors atomically and give the SHA-256 of the file, in hexadecimal.

    Equal tensors and metadata give equal bytes, whatever the version of any library. Tensors that
    share memory are each written whole.

    Raises:
        ValueError: A tensor is of a type that the format has no name for, or is not dense.
    """
    # The widest elements first, so that every tensor starts at a multiple of its element size.
    order = sorted(tensors, key=lambda name: (-tensors[name].element_size(), name))
    header: dict[str, object] = {"__metadata__": dict(sorted((metadata or {}).items()))}
    start = 0
    for name in order:
        value = tensors[name]
        if value.dtype not in DTYPES or value.layout != torch.strided:
            raise ValueError(
                f"tensor {name} is {value.dtype}, {value.layout}; wanted a dense tensor of "
                f"{', '.join(DTYPES.values())}"
            )
        end = start + value.numel() * value.element_size()
        header[name] = {
            "dtype": DTYPES[value.dtype],
            "shape": list(value.shape),
            "data_offsets": [start, end],
        }
        start = end
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    digest = hashlib.sha256()
    with replacing(path) as part, part.open("wb") as stream:
        for block in (len(text).to_bytes(8, "little"), text):
            digest.update(block)
            stream.write(block)
        for name in order:
            block = _bytes(tensors[name])
            digest.update(block)
            stream.write(block)
    return digest.hexdigest()


def _bytes(tensor: Tensor) -> memoryview:
    flat = tensor.detach().cpu().contiguous().flatten()
    return flat.view(torch.uint8).numpy().data if flat.numel() else memoryview(b"")
