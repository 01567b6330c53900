"""Semantic segmentation against the truth, from one confusion matrix."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass
class Confusion:
    """Counts pixels by their true and their predicted class, over all pictures together.

    A class that is nowhere true has no IoU and is not part of the mean.
    """

    classes: tuple[str, ...]
    counts: Int[Tensor, "truth predicted"] = field(init=False)
    """Pixels."""
    image_means: list[float] = field(init=False, default_factory=list)
    """The mean IoU of each picture over the classes that are true in it."""

    def __post_init__(self) -> None:
        size = len(self.classes)
        self.counts = torch.zeros(size, size, dtype=torch.int64)

    def add(
        self, truth: Int[Tensor, "height width"], predicted: Int[Tensor, "height width"]
    ) -> None:
        """Count the pixels of one picture.

        Args:
            truth: Places in `classes`; -1 is ignored.
            predicted: Likewise, a class wherever the truth is one.

        Raises:
            ValueError: There is another number in them.
        """
        size, valid = len(self.classes), truth >= 0
        self._check("truth", truth, -1)
        self._check("predicted", predicted[valid], 0)
        pairs = truth[valid] * size + predicted[valid]
        counts = pairs.cpu().bincount(minlength=size * size).view(size, size)
        self.counts += counts
        if valid.any():
            self.image_means.append(float(_ious(counts).nanmean()))

    def ious(self) -> dict[str, float]:
        """IoU of each class, NaN where it is nowhere true."""
        return dict(zip(self.classes, _ious(self.counts).tolist(), strict=True))

    def mean_iou(self) -> float:
        """Over the classes that are true somewhere; NaN without any pixel."""
        return float(_ious(self.counts).nanmean())

    def mean_iou_of_images(self) -> float:
        """The mean over the pictures of each one's mean IoU; NaN without any."""
        return float(torch.tensor(self.image_means, dtype=torch.float64).mean())

    def accuracy(self) -> float:
        """Share of the pixels whose class is right; NaN without any pixel."""
        return float(self.counts.diagonal().sum() / self.counts.sum())

    def _check(self, name: str, values: Tensor, least: int) -> None:
        most = len(self.classes) - 1
        wrong = values[(values < least) | (values > most)]
        if wrong.numel():
            raise ValueError(
                f"{name} has the number {int(wrong[0])}, wanted classes from {least} to {most}"
            )

    def merged(self, classes: tuple[str, ...], places: Sequence[int]) -> Int[Tensor, "n n"]:
        """The counts where every class stands for a place in other classes."""
        onto = torch.zeros(len(places), len(classes), dtype=torch.int64)
        onto[torch.arange(len(places)), torch.tensor(places)] = 1
        return onto.T @ self.counts @ onto


def _ious(counts: Int[Tensor, "truth predicted"]) -> Float[Tensor, " truth"]:
    true, hit = counts.sum(dim=1), counts.diagonal().double()
    union = true + counts.sum(dim=0) - counts.diagonal()
    return torch.where(true > 0, hit / union.clamp_min(1), torch.nan)
