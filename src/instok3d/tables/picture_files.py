"""Single pictures that the figures are put together from."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from instok3d.files import replacing


def write_picture(path: Path, picture: UInt8[np.ndarray, "height width 3"]) -> None:
    """Write a PNG as a whole."""
    with replacing(path) as part:
        Image.fromarray(picture).save(part, format="PNG")


def read_picture(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    """A PNG that `write_picture` wrote.

    Raises:
        FileNotFoundError: It is not there.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no picture {path}; remove its cell to measure it again")
    return np.asarray(Image.open(path).convert("RGB"))
