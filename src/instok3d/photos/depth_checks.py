"""Whether given depth fits the cameras: that it is there, its unit, and that the views agree on it.

A depth picture does not say its unit. Where the depth of one view, moved into another, meets that
one's own depth, the scale is right: with another scale the points move to other pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, unproject
from instok3d.photos.camera_fit import ONE_PLACE
from instok3d.photos.cameras import PhotoCamera
from instok3d.photos.depth_files import read_camera_depth
from instok3d.photos.file_names import shortened

METRES = (0.1, 100.0)
"""Median depths of photos of rooms; others are in another unit than metres."""
SPREADS = (0.05, 2000.0)
"""Median depths in spreads of the cameras, beyond which two views share nothing or no parallax."""
MAX_VIEWS, GRID = 6, 20
"""Views, and pixels along a side of each, that are compared: enough for shares of 1 %."""
TRIED = torch.logspace(-0.7, 3, 54, dtype=torch.float64)
"""Median depths in spreads of the cameras at which agreement is looked for, 17 % apart."""
NO_PARALLAX = 1e6
"""In the same units: so far away that agreement says nothing about the scale."""
TOLERANCE = 0.02
"""Relative difference of depths that agree; sensors and their poses differ by about 1 %."""
MIN_SHARE = 0.1
"""Of the pixels must agree at some scale before anything is said about the scale."""
Item = TypeVar("Item")


@dataclass(frozen=True)
class DepthViews:
    """Depth pictures with their cameras."""

    depths: Float[Tensor, "view height width"]
    """z-depth in the units of cam_from_world, 0 where it is unknown."""
    intrinsics: Float[Tensor, "view 3 3"]
    """Of these pictures."""
    cam_from_world: Float[Tensor, "view 4 4"]
    names: tuple[str, ...]
    """For messages."""

    def rows(self, which: list[int]) -> "DepthViews":
        """Some of the views."""
        names = tuple(self.names[index] for index in which)
        return DepthViews(
            self.depths[which].double(),
            self.intrinsics[which].double(),
            self.cam_from_world[which].double(),
            names,
        )


def read_depth_views(cameras: Sequence[PhotoCamera]) -> DepthViews:
    """The depth pictures of some cameras, evenly chosen, at a low resolution.

    Raises:
        FileNotFoundError: A depth picture is not there.
        ValueError: It is damaged or has another shape than its camera's image.
    """
    given = _some([camera for camera in cameras if camera.depth_path is not None])
    side = 4 * GRID
    depths = torch.zeros(len(given), side, side)
    intrinsics, poses = (torch.zeros(len(given), n, n, dtype=torch.float64) for n in (3, 4))
    for index, camera in enumerate(given):
        depth = read_camera_depth(camera)
        rows, columns = (_evenly(length, side) for length in depth.shape)
        depths[index] = depth[rows[:, None], columns]
        scale = torch.tensor([side / camera.width, side / camera.height, 1.0]).double()
        intrinsics[index] = scale[:, None] * camera.intrinsics
        poses[index] = camera.cam_from_world
    return DepthViews(depths, intrinsics, poses, tuple(camera.name for camera in given))


def check_depth(views: DepthViews, *, metric: bool) -> list[str]:
    """Refuse depth that is no depth, or in another unit than the cameras.

    Args:
        views: Of one scene; views without a depth picture are left out before.
        metric: Whether the cameras are in metres.

    Returns:
        Notes, each one sentence, on what is odd but can be used.

    Raises:
        ValueError: No view has depth, all have one value everywhere, or the scale is wrong.
    """
    if not views.names:
        return []
    known = [index for index, depth in enumerate(views.depths) if (depth > 0).any()]
    flat = [index for index in known if _is_flat(views.depths[index])]
    if not known:
        raise ValueError(
            f"the depth pictures of {shortened(views.names)} hold no depth, only zeros or numbers "
            "that mean none; export them again or leave the depth out"
        )
    if len(flat) == len(known):
        value = float(views.depths[flat[0]].max())
        raise ValueError(
            f"the depth of {shortened([views.names[index] for index in flat])} is {value:g} in "
            "every pixel, as of a saturated or empty picture; export it again or leave it out"
        )
    empty = [name for index, name in enumerate(views.names) if index not in known]
    notes = []
    if empty:
        notes.append(f"the depth pictures of {shortened(empty)} hold no depth")
    if flat:
        named = shortened([views.names[index] for index in flat])
        notes.append(f"the depth of {named} is the same in every pixel, as of a saturated picture")
    usable = views.rows([index for index in known if index not in flat])
    return notes + _check_scale(usable, metric=metric)


def _is_flat(depth: Float[Tensor, "height width"]) -> bool:
    values = depth[depth > 0]
    return len(values) > 1 and bool((values == values[0]).all())


def _check_scale(views: DepthViews, *, metric: bool) -> list[str]:
    median = float(views.depths[views.depths > 0].median())
    if metric and not METRES[0] <= median <= METRES[1]:
        raise ValueError(
            f"the depth of {views.names[0]} and the others is {median:.3g} m in the median, which "
            "is no room: the depth scale (stored numbers in one metre) is wrong, such as 1000 for "
            "numbers that are metres already"
        )
    centers = invert_rigid(views.cam_from_world)[:, :3, 3]
    spread = float((centers - centers.mean(dim=0)).norm(dim=1).max())
    if len(views.names) < 2 or spread <= ONE_PLACE * max(1.0, float(centers.norm(dim=1).max())):
        return []  # without parallax nothing can be said about the scale
    return _compare(views, median, spread)


def _compare(views: DepthViews, median: float, spread: float) -> list[str]:
    comparison = _Comparison(views.rows(_some(range(len(views.names)))), median, spread)
    given = median / spread
    agreeing, compared = comparison.shares(given)
    without_parallax = comparison.shares(NO_PARALLAX)[0]
    if agreeing > max(0.85 * compared, 1.25 * without_parallax, MIN_SHARE):
        return []  # no other scale could be much better
    tried = [comparison.shares(float(depth))[0] for depth in TRIED]
    best = max(tried)
    best_at = float(TRIED[tried.index(best)]) / given
    clear = best >= MIN_SHARE and best > 1.25 * max(agreeing, without_parallax)
    if clear and not 1 / 1.3 < best_at < 1.3:
        raise ValueError(
            f"the depth does not fit the cameras: the views agree on {agreeing:.0%} of their "
            f"pixels, but on {best:.0%} with depths about {best_at:.2g} times as large; correct "
            "the depth scale, or leave the depth out"
        )
    if compared >= 0.2 and agreeing < 0.1 * compared:
        return [
            f"the depth and the cameras of the photos contradict each other: where two views see "
            f"the same, only {agreeing / compared:.0%} of their depths agree"
        ]
    if not SPREADS[0] <= given <= SPREADS[1]:
        return [
            f"the depth is {given:.2g} times as large as the distances between the cameras, so "
            "that its scale could not be checked"
        ]
    return []


def _some(items: Sequence[Item]) -> list[Item]:
    """At most MAX_VIEWS, evenly chosen."""
    last = len(items) - 1
    if last < MAX_VIEWS:
        return list(items)
    return [items[index * last // (MAX_VIEWS - 1)] for index in range(MAX_VIEWS)]


def _evenly(length: int, count: int) -> Int[Tensor, " {count}"]:
    """Indices in the middle of each of `count` equal parts."""
    return ((torch.arange(count) + 0.5) * length / count).long()


class _Comparison:
    """Points of every view moved into every other, at any scale of the depth."""

    def __init__(self, views: DepthViews, median: float, spread: float) -> None:
        self._height, self._width = views.depths.shape[1:]
        self._depths = views.depths / median
        rows, columns = _evenly(self._height, GRID), _evenly(self._width, GRID)
        points = unproject(self._depths, views.intrinsics)[:, rows[:, None], columns].flatten(1, 2)
        other_from_view = views.cam_from_world[None] @ invert_rigid(views.cam_from_world)[:, None]
        self._turned = points[:, None] @ other_from_view[..., :3, :3].mT
        self._moves = other_from_view[..., None, :3, 3] / spread
        others = ~torch.eye(len(points), dtype=torch.bool)
        self._known = (points[..., 2] > 0)[:, None] & others[..., None]
        self._total = max(int(self._known.sum()), 1)
        self._focal = views.intrinsics.diagonal(dim1=-2, dim2=-1)[:, None, :2]
        self._center = views.intrinsics[:, None, :2, 2]

    def shares(self, depth: float) -> tuple[float, float]:
        """Of the known points, how many agree and how many meet a known depth at all.

        Args:
            depth: The median depth in spreads of the cameras.
        """
        moved = depth * self._turned + self._moves
        z = moved[..., 2]
        pixels = moved[..., :2] / z[..., None] * self._focal + self._center
        column, row = pixels.nan_to_num(-1.0).unbind(-1)
        inside = (
            (z > 0) & (column >= 0) & (column < self._width) & (row >= 0) & (row < self._height)
        )
        column = column.clamp(0, self._width - 1).long()
        row = row.clamp(0, self._height - 1).long()
        other = torch.arange(len(self._depths))[None, :, None]
        there = depth * self._depths[other, row, column]
        compared = self._known & inside & (there > 0)
        agreeing = compared & ((z - there).abs() < TOLERANCE * there)
        return int(agreeing.sum()) / self._total, int(compared.sum()) / self._total
