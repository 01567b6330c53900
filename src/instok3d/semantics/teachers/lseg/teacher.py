"""LSeg as a teacher: 512 channels for every second pixel, in the space of CLIP's texts."""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.files import sha256_of
from instok3d.semantics.teachers.images import IMAGES_AT_ONCE, in_parts, resized, unit
from instok3d.semantics.teachers.lseg.byte_pairs import load_byte_pairs
from instok3d.semantics.teachers.lseg.weights import load_networks
from instok3d.semantics.teachers.texts import check_texts

MERGES = "merges.txt"
LOGIT_SCALE = 1 / 0.07
"""What cosines are multiplied by before a softmax over labels; LSeg never learned another."""
CELL = 32
"""The coarsest scale has a cell for so many pixels."""


class LSegTeacher:
    """LSeg (Li et al., ICLR 2022), the paper's teacher."""

    def __init__(self, path: Path, device: torch.device | str = "cpu") -> None:
        """The teacher of a converted checkpoint; `merges.txt` of CLIP stands beside it.

        Raises:
            FileNotFoundError: One of the two files is not there.
            ValueError: They are damaged, are not LSeg's, or do not fit each other.
        """
        networks = load_networks(path)
        self._pairs = load_byte_pairs(path.parent / MERGES)
        sizes = networks.text.sizes
        if self._pairs.size != sizes.vocabulary:
            raise ValueError(
                f"{path.parent / MERGES} makes {self._pairs.size} tokens, and the text encoder of "
                f"{path} knows {sizes.vocabulary}: take the list of clip-vit-base-patch32"
            )
        self.name = f"lseg-{sha256_of(path)[:12]}"
        self.channels = sizes.features
        self.device = torch.device(device)
        self._pretrained = networks.pretrained.to(self.device)
        self._scratch = networks.scratch.to(self.device)
        self._text = networks.text.to(self.device)

    @torch.no_grad()
    def features(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Float[Tensor, "view {self.channels} _rows _columns"]:
        """Unit features at half the resolution of the images.

        Sides that are no multiple of 32 are first stretched to the nearest one.

        Args:
            images: sRGB in [0, 1].
        """
        return in_parts(self._features, images.to(self.device), IMAGES_AT_ONCE)

    def _features(self, images: Tensor) -> Tensor:
        height, width = (max(1, round(side / CELL)) * CELL for side in images.shape[2:])
        scales = self._pretrained(2 * resized(images, height, width) - 1)
        return unit(self._scratch(scales))

    @torch.no_grad()
    def text(self, texts: Sequence[str]) -> Float[Tensor, "text {self.channels}"]:
        """A unit vector for each text, as it stands: LSeg was trained on bare words.

        Raises:
            ValueError: A text is empty or too long.
        """
        check_texts(texts)
        if not texts:
            return torch.zeros(0, self.channels, device=self.device)
        ids = self._pairs.encode(texts, self._text.sizes.longest)
        return unit(self._text(ids.to(self.device)))

    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " {self.channels}"]:
        """The mean of an image's features, of unit length."""
        return unit(self.features(image[None]).mean(dim=(2, 3)))[0]


def label_scores(
    features: Float[Tensor, "view channel rows columns"], texts: Float[Tensor, "text channel"]
) -> Float[Tensor, "view text 2*rows 2*columns"]:
    """Scores of labels as in the 8-class protocol: their largest is the label of a pixel.

    The cosine to each text's vector times LOGIT_SCALE, doubled in size with corners aligned.
    """
    cosines = torch.einsum("vchw,tc->vthw", unit(features), unit(texts))
    return functional.interpolate(
        LOGIT_SCALE * cosines, scale_factor=2.0, mode="bilinear", align_corners=True
    )
