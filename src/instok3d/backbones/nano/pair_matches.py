"""Matches between pairs of views, and the photos and geometry that they are compared with."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.backbones.nano.alignment import PhotoGeometry, sample_depth
from instok3d.backbones.nano.bundle_problem import Observations
from instok3d.backbones.nano.matching import MATCH_STRIDE, Matches, join_matches
from instok3d.geometry.registration import MatchedPoints


@dataclass(frozen=True)
class PairMatches:
    """Matches between two views of each scene of the batch, in both directions."""

    views_a: Int[Tensor, " batch"]
    views_b: Int[Tensor, " batch"]
    of_a: Matches
    """Matches of the cells of a in b."""
    of_b: Matches
    """Matches of the cells of b in a."""

    @property
    def ways(self) -> tuple[tuple[Tensor, Tensor, Matches], tuple[Tensor, Tensor, Matches]]:
        """(views here, views there, matches of cells of here in there), in both directions."""
        return (
            (self.views_a, self.views_b, self.of_a),
            (self.views_b, self.views_a, self.of_b),
        )


@dataclass(frozen=True)
class Ways:
    """Both directions of every pair of every scene, one row each."""

    scenes: Int[Tensor, " row"]
    here: Int[Tensor, " row"]
    there: Int[Tensor, " row"]
    matches: Matches
    """Of cells of here in there; a batch of rows."""

    @staticmethod
    def of(pairs: list[PairMatches], batch: int) -> "Ways":
        """Of at least one pair, whose matches are of the same cells."""
        ways = [way for pair in pairs for way in pair.ways]
        here, there, matches = zip(*ways, strict=True)
        scenes = torch.arange(batch, device=here[0].device).repeat(len(ways))
        return Ways(scenes, torch.cat(here), torch.cat(there), join_matches(matches))

    def to_pairs(self, pairs: list[PairMatches]) -> list[PairMatches]:
        """These matches, of the pairs that the rows were made of."""
        parts = self.matches.split(2 * len(pairs))
        return [
            replace(pair, of_a=of_a, of_b=of_b)
            for pair, of_a, of_b in zip(pairs, parts[::2], parts[1::2], strict=True)
        ]


@dataclass(frozen=True)
class SolvedViews:
    """Solved cameras, focal length and coarse depth corrections of all views."""

    cam_from_first: Float[Tensor, "batch view 4 4"]
    """In units of the depths."""
    log_focal: Float[Tensor, " batch"]
    """Logarithm of the focal length over its initial value; one for all views of a scene."""
    log_depth_correction: Float[Tensor, "batch view height width"]
    """To be added to the log depths."""


@dataclass(frozen=True)
class PhotoViews:
    """Photos of all views with their current depths and intrinsics."""

    images: Float[Tensor, "batch view 3 height width"]
    depths: Float[Tensor, "batch view height width"]
    """> 0."""
    intrinsics: Float[Tensor, "batch view 3 3"]
    """Pixels."""

    def at(
        self,
        scenes: Int[Tensor, " row"],
        views: Int[Tensor, " row"],
        cam_from_first: Float[Tensor, "batch view 4 4"],
    ) -> PhotoGeometry:
        """One view of a scene in each row."""
        parts = (self.images, self.depths, self.intrinsics, cam_from_first)
        return PhotoGeometry(*(part[scenes, views] for part in parts))

    def corrected(self, solved: SolvedViews) -> "PhotoViews":
        """With the solved depth corrections and focal length applied."""
        return replace(
            self,
            depths=self.depths * solved.log_depth_correction.exp(),
            intrinsics=scale_focal(self.intrinsics, solved.log_focal),
        )


@dataclass(frozen=True)
class MatchedCells(MatchedPoints):
    """Cells of one view, unprojected by its depth, with their matches in another view."""

    precision: Float[Tensor, "batch point 2 2"]
    """Inverse covariance of the rays."""

    def split(self, parts: int) -> "list[MatchedCells]":
        """So many equal parts of the batch."""
        rows = zip(*(value.chunk(parts) for value in vars(self).values()), strict=True)
        return [MatchedCells(*row) for row in rows]


def matched_cells(ways: Ways, views: PhotoViews) -> MatchedCells:
    """The cells of each row's view here with their matches in there."""
    scenes, matches = ways.scenes, ways.matches
    own = matches.centers.expand(len(scenes), -1, -1)
    points = _points_at(own, views.depths[scenes, ways.here], views.intrinsics[scenes, ways.here])
    intrinsics = views.intrinsics[scenes, ways.there]
    matched = _points_at(matches.pixels, views.depths[scenes, ways.there], intrinsics)
    focal = torch.stack([intrinsics[:, 0, 0], intrinsics[:, 1, 1]], dim=-1)
    by_focal = (focal[:, :, None] * focal[:, None, :])[:, None]
    rays = matched[..., :2] / matched[..., 2:]
    return MatchedCells(points, rays, matched, matches.confidence, matches.precision * by_focal)


def scale_focal(
    intrinsics: Float[Tensor, "batch view 3 3"], log_focal: Float[Tensor, " batch"]
) -> Float[Tensor, "batch view 3 3"]:
    """Intrinsics with the focal lengths multiplied by exp(log_focal)."""
    scale = torch.ones_like(intrinsics)
    scale[..., 0, 0] = scale[..., 1, 1] = log_focal.exp()[:, None]
    return intrinsics * scale


def subsample_matches(pairs: list[PairMatches], views: PhotoViews) -> list[PairMatches]:
    """The matches of every second cell in each direction of the image.

    Before alignment, errors of neighbouring cells correlate: all matches carry little more
    information than a quarter of them.
    """
    rows, columns = (size // MATCH_STRIDE for size in views.depths.shape[-2:])
    number = torch.arange(rows * columns, device=views.depths.device).view(rows, columns)
    cells = number[::2, ::2].flatten()
    return [replace(pair, of_a=pair.of_a.at(cells), of_b=pair.of_b.at(cells)) for pair in pairs]


def pair_observations(pairs: list[PairMatches], views: PhotoViews) -> Observations:
    """Observations of both directions of every pair of every scene, one row each."""
    height, width = views.depths.shape[-2:]
    size = torch.tensor([width, height]).to(views.depths)
    ways = Ways.of(pairs, len(views.depths))
    cells = matched_cells(ways, views)
    return Observations(
        scenes=ways.scenes,
        here=ways.here,
        there=ways.there,
        points=cells.points,
        rays=cells.rays,
        precision=cells.precision,
        depths=cells.matched[..., 2],
        confidence=cells.confidence,
        positions_here=(ways.matches.centers / size).expand(len(ways.scenes), -1, -1),
        positions_there=ways.matches.pixels / size,
    )


def _points_at(
    pixels: Float[Tensor, "batch point 2"],
    depths: Float[Tensor, "batch height width"],
    intrinsics: Float[Tensor, "batch 3 3"],
) -> Float[Tensor, "batch point 3"]:
    """Surface points at positions in an image, in the camera's frame."""
    rays = torch.cat([pixels, torch.ones_like(pixels[..., :1])], dim=-1) @ intrinsics.inverse().mT
    return rays * sample_depth(depths, pixels)[..., None]
