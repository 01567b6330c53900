"""A 2D instance network of single photos: what SAM is to methods that are given masks.

Learned queries gather from the patches of one photo and become its instances; every cell of the
photo is shared among them and the void by a softmax, as anchors are among groups (Eq. 3). It is
trained like the tokenizer's groups, on the same rooms, but sees neither other views nor depth.
"""

from dataclasses import dataclass, field

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from instok3d.evaluation.instance_ap import PredictedMasks, predicted_masks
from instok3d.model.grouping import Assignment
from instok3d.model.transformer import Decoder
from instok3d.semantics.predictor import Predictor, PredictorConfig

MIN_MASK_PX = 10
"""Smaller masks are dropped, as AP drops them."""
VOID = 0
"""In id maps: no instance."""


@dataclass(frozen=True)
class SegmenterConfig:
    """Sizes of the segmenter."""

    predictor: PredictorConfig = field(default_factory=PredictorConfig)
    """Stem, attention blocks and upsampling, those of the embedded teacher."""
    num_queries: int = 40
    """Most instances of a photo; the nano tokenizer has as many groups for a room."""
    decoder_layers: int = 3
    """Of the queries: attention to the photo, to each other, MLP."""

    def __post_init__(self) -> None:
        for name in ("num_queries", "decoder_layers"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.predictor.channels != self.predictor.width:
            raise ValueError(
                "predictor.channels and predictor.width of a segmenter must be equal, got "
                f"{self.predictor.channels} and {self.predictor.width}"
            )


class Segmenter(nn.Module):
    """Photos in, the share of each query and of the void in every pixel out; each photo alone."""

    def __init__(self, config: SegmenterConfig) -> None:
        super().__init__()
        self.config = config
        width, head = config.predictor.width, config.predictor.head_width
        self.predictor = Predictor(config.predictor)
        self.queries = nn.Parameter(0.5 * torch.randn(config.num_queries, width))
        self.decoder = Decoder(
            width, config.decoder_layers, self_attention=True, head_size=head, normalize_heads=True
        )
        self.assignment = Assignment(width)

    def forward(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Float[Tensor, "view column height width"]:
        """Shares of the queries and, last, of the void, which sum to 1 in every pixel. Float32.

        Args:
            images: sRGB in [0, 1], sides multiples of `semantics.predictor.PATCH`.
        """
        encoded = self.predictor.encode(images)
        queries = self.decoder(self.queries.expand(len(images), -1, -1), encoded.tokens)
        shares = self.assignment(encoded.features.flatten(2).mT, queries)
        cells = shares.mT.unflatten(2, encoded.features.shape[-2:])
        size = (images.shape[-2], images.shape[-1])
        return functional.interpolate(cells, size, mode="bilinear", align_corners=False)

    @torch.no_grad()
    def masks(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Int[Tensor, "view height width"]:
        """The instances of each photo: ids 1, 2, ... in each anew, 0 where the void has the most.

        Args:
            images: See `forward`.
        """
        if not len(images):
            return images.new_zeros(0, *images.shape[-2:], dtype=torch.int64)
        ids = (self(images).argmax(dim=1) + 1) % (self.config.num_queries + 1)
        return torch.stack([_renumbered(each) for each in ids])

    @torch.no_grad()
    def found(self, images: Float[Tensor, "view 3 height width"]) -> list[PredictedMasks]:
        """Masks of each photo with confidences, by the rule of AP (`evaluation.instance_ap`)."""
        maps = self(images)[:, :-1]
        covered = torch.ones_like(maps[:, 0])
        return [predicted_masks(*each) for each in zip(maps, covered, strict=True)]


def _renumbered(ids: Int[Tensor, "height width"]) -> Int[Tensor, "height width"]:
    """Ids 1, 2, ... of the masks that are large enough."""
    names, places, areas = ids.unique(return_inverse=True, return_counts=True)
    kept = (names != VOID) & (areas >= MIN_MASK_PX)
    return torch.where(kept, kept.cumsum(dim=0), VOID)[places]
