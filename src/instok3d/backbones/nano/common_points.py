"""Mutual matches of two photos that look alike: evidence of overlap that needs no cameras."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from instok3d.backbones.nano.bundle_problem import CONFIDENCE_MIN
from instok3d.backbones.nano.matching import MATCH_STRIDE, Matches
from instok3d.backbones.nano.pair_matches import PairMatches

RETURN_PX = 1.5 * MATCH_STRIDE
"""A match is mutual if the match of the cell it hits returns this close: to its own cell or a
neighbour of it."""
PATCH_REACH = 4
"""Pixels of a patch on each side of its centre: patches have 9 x 9."""
ALIKE_MIN = 0.7
"""Least normalized cross-correlation of two patches that look alike. A tenth of the matches between
photos of different rooms reach it, and a third or more of those within one room."""
CONTRAST_MIN = 0.02
"""Least standard deviation of the grey values of a patch, in [0, 1]. Flatter patches are mostly
noise, and correlate by chance."""


@dataclass(frozen=True)
class CommonPoints:
    """Points of two views of a scene that match each other both ways and look alike."""

    view_a: int
    view_b: int
    pixels_a: Float[Tensor, "point 2"]
    pixels_b: Float[Tensor, "point 2"]
    share: float
    """Number of points over the number of cells of both views."""


@torch.no_grad()
def find_common_points(
    pairs: list[PairMatches], images: Float[Tensor, "view 3 height width"]
) -> list[CommonPoints]:
    """The common points of each pair of views, for the first scene of a batch.

    Args:
        pairs: As `NanoBackbone.find_matches` gives them.
        images: The photos of that scene.
    """
    grey = images.float().mean(1, keepdim=True)
    columns = images.shape[-1] // MATCH_STRIDE
    found = []
    for pair in pairs:
        a, b = int(pair.views_a[0]), int(pair.views_b[0])
        # 1. Confident matches that lead back to their start, in both directions.
        of_a = _mutual(pair.of_a, pair.of_b, columns)
        of_b = _mutual(pair.of_b, pair.of_a, columns)
        pixels_a = torch.cat([pair.of_a.centers[of_a], pair.of_b.pixels[0][of_b]])
        pixels_b = torch.cat([pair.of_a.pixels[0][of_a], pair.of_b.centers[of_b]])
        # 2. Of these, the ones whose patches look alike.
        alike = _alike(_patches(grey[a], pixels_a), _patches(grey[b], pixels_b))
        share = float(alike.sum()) / (len(of_a) + len(of_b))
        found.append(CommonPoints(a, b, pixels_a[alike], pixels_b[alike], share))
    return found


def contrast_share(images: Float[Tensor, "view 3 height width"]) -> Float[Tensor, " view"]:
    """Share of each photo's pixels whose patch has contrast."""
    grey = images.float().mean(1, keepdim=True)
    size = 2 * PATCH_REACH + 1
    mean = functional.avg_pool2d(grey, size, 1)
    variance = functional.avg_pool2d(grey.square(), size, 1) - mean.square()
    return (variance > CONTRAST_MIN**2).float().mean((1, 2, 3))


def _mutual(matches: Matches, back: Matches, columns: int) -> Bool[Tensor, " cell"]:
    """Which cells have a confident match whose own match leads back to them."""
    rows = len(back.centers) // columns
    x, y = (matches.pixels[0] / MATCH_STRIDE).floor().long().unbind(-1)
    cells = y.clamp(0, rows - 1) * columns + x.clamp(0, columns - 1)
    away = (back.pixels[0][cells] - matches.centers).norm(dim=-1)
    return (matches.confidence[0] > CONFIDENCE_MIN) & (away < RETURN_PX)


def _patches(
    grey: Float[Tensor, "1 height width"], pixels: Float[Tensor, "point 2"]
) -> Float[Tensor, "point value"]:
    """Grey values of the patches around pixels of one image, less the mean of each patch."""
    reach = torch.arange(-PATCH_REACH, PATCH_REACH + 1.0, device=pixels.device)
    offsets = torch.cartesian_prod(reach, reach)
    size = torch.tensor([grey.shape[-1], grey.shape[-2]]).to(pixels)
    places = (pixels[:, None] + offsets) / size * 2 - 1
    values = functional.grid_sample(
        grey[None], places[None], padding_mode="border", align_corners=False
    )[0, 0]
    return values - values.mean(1, keepdim=True)


def _alike(
    a: Float[Tensor, "point value"], b: Float[Tensor, "point value"]
) -> Bool[Tensor, " point"]:
    """Whether two patches have contrast and correlate; gain and offset do not matter."""
    deviation_a, deviation_b = (each.square().mean(1).sqrt() for each in (a, b))
    correlation = (a * b).mean(1) / (deviation_a * deviation_b).clamp_min(1e-9)
    return (correlation > ALIKE_MIN) & (torch.minimum(deviation_a, deviation_b) > CONTRAST_MIN)
