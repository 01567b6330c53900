"""Pictures that requests bring."""

from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from instok3d.photos.image_decoding import decode_bytes
from instok3d.service.parameters import ArgumentError

MOST_BYTES = 8 * 1024**2
MOST_PIXELS = 16_000_000
SIDE = 256
"""Pictures are looked at in a square of so many pixels, the rest cropped away."""


def decoded_picture(data: bytes) -> Float[Tensor, "3 height width"]:
    """A picture of one thing, in [0, 1].

    Raises:
        ArgumentError: It is none, is damaged or has too many pixels.
    """
    if not data:
        raise ArgumentError("no picture came: send the bytes of a JPEG, PNG or WebP file as body")
    name = Path("the picture that was sent")
    try:
        return decode_bytes(data, name, height=SIDE, width=SIDE, max_pixels=MOST_PIXELS).image
    except (ValueError, MemoryError) as error:
        raise ArgumentError(
            f"the body is no picture that can be read: send a sound JPEG, PNG or WebP of at most "
            f"{MOST_PIXELS / 1e6:g} megapixels"
        ) from error
