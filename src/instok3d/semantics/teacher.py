"""What the semantic features of a scene are learned from: an encoder of pixels, or of texts."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor


@runtime_checkable
class Teacher(Protocol):
    """Features of photos, and of texts and picture crops in the same space.

    An encoder that lacks one of the three raises a ValueError that names itself and what it lacks.
    """

    name: str
    """Of encoder and version; features of teachers with different names cannot be compared."""
    channels: int
    """D: length of a feature."""

    def features(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Float[Tensor, "view channel row column"]:
        """A feature of each cell of the photos (sRGB in [0, 1]), of any length, row-major."""
        ...

    def text(self, texts: Sequence[str]) -> Float[Tensor, "text channel"]:
        """A unit vector for each text."""
        ...

    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " channel"]:
        """A unit vector for a picture of one thing (sRGB in [0, 1])."""
        ...
