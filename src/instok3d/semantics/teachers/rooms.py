"""The embedded teacher: a predictor trained on rooms with words, and a table of text."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.semantics.predictor import PATCH, Predictor
from instok3d.semantics.text import TextTable

SIDE = 128
"""Photos are looked at with their shorter side at so many pixels, as in training."""


class RoomTeacher:
    """Features in the space of the text table, from photos alone; a `Teacher`.

    Args:
        predictor: Trained; it is set to evaluation.
        table: In whose space it predicts.
        name: Of this version.
        credits: Whose work the rooms show that it was trained on, one line each.
    """

    def __init__(
        self,
        predictor: Predictor,
        table: TextTable,
        name: str = "rooms-1",
        credits: Sequence[str] = (),
    ) -> None:
        self.predictor = predictor.eval()
        self.table = table
        self.name = name
        self.credits = tuple(credits)
        self.channels = predictor.config.channels

    @property
    def device(self) -> torch.device:
        """Where the predictor runs; texts are always embedded on the CPU."""
        return self.predictor.norm.weight.device

    @torch.no_grad()
    def features(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Float[Tensor, "view channel row column"]:
        """A feature of each cell, half as many cells each way as pixels when seen at SIDE.

        It is the mean of what the predictor says of the photo and of its mirror image, which is
        right more often than either (docs/log.md).

        Args:
            images: sRGB in [0, 1], of any size; one view at a time is in memory.
        """
        images = images.to(self.device)
        height, width = images.shape[-2:]
        scale = SIDE / max(1, min(height, width))
        size = tuple(max(PATCH, round(each * scale / PATCH) * PATCH) for each in (height, width))
        if not len(images):
            rows, columns = (each // 2 for each in size)
            return images.new_zeros(0, self.channels, rows, columns)
        return torch.cat([self._seen(_resized(image[None], size)) for image in images])

    def _seen(
        self, image: Float[Tensor, "1 3 height width"]
    ) -> Float[Tensor, "1 channel row column"]:
        found, mirrored = self.predictor(torch.cat([image, image.flip(-1)])).split(1)
        return (found + mirrored.flip(-1)) / 2

    def text(self, texts: Sequence[str]) -> Float[Tensor, "text channel"]:
        """A unit vector for each text.

        Raises:
            ValueError: A text has no word that the table knows.
        """
        return self.table.embed(texts)

    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " channel"]:
        """A unit vector for a picture of one thing: the mean direction of its middle half."""
        directions = functional.normalize(self.features(image[None])[0], dim=0)
        rows, columns = directions.shape[-2:]
        middle = directions[:, rows // 4 : rows - rows // 4, columns // 4 : columns - columns // 4]
        return functional.normalize(middle.mean(dim=(1, 2)), dim=0)


def _resized(
    image: Float[Tensor, "1 3 height width"], size: tuple[int, ...]
) -> Float[Tensor, "1 3 new_height new_width"]:
    if tuple(image.shape[-2:]) == size:
        return image
    return functional.interpolate(
        image, size, mode="bilinear", antialias=True, align_corners=False
    ).clamp(0, 1)
