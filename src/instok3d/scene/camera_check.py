"""Whether given cameras agree with the matches of their photos; if not, which mix-up would."""

from collections.abc import Callable, Sequence
from itertools import permutations, product

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.backbones.nano.common_points import CommonPoints
from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.epipolar import match_errors

EVIDENCE_SHARE = 0.05
"""Pairs with a smaller share of common points are no evidence: too many of these may be wrong (one
view of the study room, with shares of 2 to 4 %, seems to contradict its true camera)."""
TOLERANCE_PX = 3.0
"""Largest epipolar error of an inlier. Matches are accurate to about a pixel; the rest allows for
given cameras that are right but not exact."""
FITTING = 0.6
"""Least share of inliers of cameras that agree with their photos. docs/log.md (2026-11-28) has the
measurement: true cameras have 0.74 or more in all of 217 sets, wrong ones less than 0.6 in 98 %."""
CONTRADICTED = 0.3
"""A view whose camera alone is wrong has a smaller share of inliers with each of at least two
others. True cameras with a focal length that is 11 % off (7-Scenes with the K of its depth camera)
have more."""
EXPLAINED, BETTER = 0.7, 0.25
"""A mix-up is named if undoing it gives this share of inliers, and this much more than before. If
single views contradict the others, it must give each of these the same share instead."""
NUM_USUAL = 4
"""How many of the mix-ups are usual; `_mix_ups` lists these first."""
TIE = 0.03
"""Mix-ups whose shares differ by no more than this explain the photos equally well."""

Change = Callable[[Float[Tensor, "view 4 4"]], Float[Tensor, "view 4 4"]]


def camera_notes(
    points: Sequence[CommonPoints],
    cam_from_world: Float[Tensor, "view 4 4"],
    intrinsics: Float[Tensor, "view 3 3"],
    names: Sequence[str],
) -> list[str]:
    """A note if the photos contradict the cameras, with the mix-up that explains it; else none.

    Epipolar errors do not depend on scale, so cameras in another unit pass; so do cameras whose
    errors stay within the tolerance.

    Args:
        points: Of pairs of these views.
        cam_from_world: As given.
        intrinsics: Of the images in whose pixels the points are.
        names: Of the photos.
    """
    sure = [pair for pair in points if pair.share >= EVIDENCE_SHARE]
    cameras, intrinsics = cam_from_world.double(), intrinsics.double()
    fits = [float(fit_share(pair, cameras, intrinsics)) for pair in sure]
    total = _mean_fit(sure, fits)
    measured = (
        f"{total:.0%} of {sum(len(pair.pixels_a) for pair in sure):,} matches agree with the "
        f"cameras to within {TOLERANCE_PX:g} pixels of the model's images"
    )
    alone = _contradicted_alone(sure, fits)
    alone = alone if 2 * len(alone) < len(names) else []
    misfit = bool(sure) and total < FITTING
    if not (misfit or alone):
        return []
    why = _explain(sure, cameras, intrinsics, total, alone)
    if why is None and alone:
        listed = ", ".join(names[view] for view in alone)
        return [f"the given cameras of these photos contradict the others: {listed} ({measured})"]
    why = why or (
        "neither inverted matrices nor other axes explain it: check which camera belongs to which "
        "photo, and the intrinsics"
    )
    return [f"the given cameras contradict the photos: {measured}; {why}"]


def fit_share(
    pair: CommonPoints,
    cameras: Float[Tensor, "*batch view 4 4"],
    intrinsics: Float[Tensor, "view 3 3"],
) -> Float[Tensor, "*batch"]:
    """Share of inliers among the points of a pair: those within TOLERANCE_PX of the epipolar line.

    Args:
        pair: With one point at least.
        cameras: cam_from_world of all views, float64, in any unit.
        intrinsics: Of the images in whose pixels the points are, float64.
    """
    a, b = pair.view_a, pair.view_b
    b_from_a = cameras[..., b, :, :] @ invert_rigid(cameras[..., a, :, :])
    errors = match_errors(
        pair.pixels_a.double(), pair.pixels_b.double(), b_from_a, intrinsics[a], intrinsics[b]
    )
    return (errors < TOLERANCE_PX).double().mean(-1)


def _mean_fit(pairs: Sequence[CommonPoints], fits: Sequence[float]) -> float:
    """Share of inliers among the points of all pairs; 0 without pairs."""
    counts = [len(pair.pixels_a) for pair in pairs]
    return sum(fit * n for fit, n in zip(fits, counts, strict=True)) / max(sum(counts), 1)


def _contradicted_alone(pairs: Sequence[CommonPoints], fits: Sequence[float]) -> list[int]:
    """Views that disagree with all others, if those agree with one another; otherwise none."""
    own: dict[int, list[float]] = {}
    for pair, fit in zip(pairs, fits, strict=True):
        for view in (pair.view_a, pair.view_b):
            own.setdefault(view, []).append(fit)
    wrong = [view for view in sorted(own) if len(own[view]) > 1 and max(own[view]) < CONTRADICTED]
    rest = [
        (pair, fit)
        for pair, fit in zip(pairs, fits, strict=True)
        if pair.view_a not in wrong and pair.view_b not in wrong
    ]
    others_fit = _mean_fit([pair for pair, _ in rest], [fit for _, fit in rest]) >= FITTING
    return wrong if others_fit else []


def _explain(
    pairs: Sequence[CommonPoints],
    cameras: Tensor,
    intrinsics: Tensor,
    given: float,
    alone: Sequence[int],
) -> str | None:
    """The mix-ups whose reversal makes the cameras agree; None if there is none.

    Of those that explain the photos equally well all usual ones are named; if none of them is
    usual, the first.
    """
    changes = _mix_ups()
    tried = torch.stack([change(cameras) for _, change in changes])
    fits = [fit_share(pair, tried, intrinsics).tolist() for pair in pairs]
    scores = []
    for number in range(len(changes)):
        fits_now = [fit[number] for fit in fits]
        score = _mean_fit(pairs, fits_now)
        needed = given + BETTER
        if alone and min(_view_fits(pairs, fits_now, alone)) >= EXPLAINED:
            needed = given
        scores.append(score if score >= max(EXPLAINED, needed) else 0.0)
    if max(scores) == 0:
        return None
    tied = [number for number, score in enumerate(scores) if score >= max(scores) - TIE]
    usual = [number for number in tied if number < NUM_USUAL] or tied[:1]
    return f"{max(scores):.0%} would if " + ", or if ".join(changes[each][0] for each in usual)


def _view_fits(
    pairs: Sequence[CommonPoints], fits: Sequence[float], views: Sequence[int]
) -> list[float]:
    """For each of some views the share of inliers among the points of its pairs."""
    rows = list(zip(pairs, fits, strict=True))
    own = [[row for row in rows if view in (row[0].view_a, row[0].view_b)] for view in views]
    return [_mean_fit([pair for pair, _ in each], [fit for _, fit in each]) for each in own]


def _mix_ups() -> list[tuple[str, Change]]:
    """Mix-ups of conventions, the usual ones first, each with what undoes it."""
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    # The same mistake, in a file format with OpenCV axes and in one with OpenGL axes.
    inverted = "the matrices were inverted (world-from-camera for camera-from-world, or back)"
    found: list[tuple[str, Change]] = [
        (f"{inverted}, in OpenCV axes", invert_rigid),
        (
            "y and z of the camera axes were reversed (OpenGL for OpenCV, or back)",
            lambda cameras: _turned(flip, cameras),
        ),
        (f"{inverted}, in OpenGL axes", lambda cameras: _turned(flip, invert_rigid(cameras))),
        ("the translations were camera centres", _centres_as_translations),
    ]
    for axes in _axis_rotations():
        named = f"the cameras' axes were {_axis_names(axes)} instead of right, down and forward"
        found += [
            (named, lambda cameras, axes=axes: _turned(axes, cameras)),
            (
                f"{inverted} and {named}",
                lambda cameras, axes=axes: _turned(axes, invert_rigid(cameras)),
            ),
        ]
    return found


def _turned(rotation: Float[Tensor, "3 3"], cameras: Tensor) -> Tensor:
    """The cameras with their own axes rotated."""
    return rigid(rotation, torch.zeros(3, dtype=torch.float64)) @ cameras


def _centres_as_translations(cameras: Tensor) -> Tensor:
    rotation = cameras[..., :3, :3]
    return rigid(rotation, -(rotation @ cameras[..., :3, 3:])[..., 0])


def _axis_rotations() -> list[Float[Tensor, "3 3"]]:
    """The 24 rotations that permute and flip axes."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = torch.zeros(3, 3, dtype=torch.float64)
            matrix[range(3), list(order)] = torch.tensor(signs, dtype=torch.float64)
            if float(torch.linalg.det(matrix)) > 0:
                found.append(matrix)
    return found


def _axis_names(cv_from_given: Float[Tensor, "3 3"]) -> str:
    """Directions of x, y and z of the given axes, in words."""
    words = (("right", "left"), ("down", "up"), ("forward", "backward"))
    names = []
    for column in cv_from_given.T:
        axis = int(column.abs().argmax())
        names.append(words[axis][0 if column[axis] > 0 else 1])
    return "x {}, y {} and z {}".format(*names)
