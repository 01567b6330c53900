"""Views that no other confirms: another room, a covered photo, or a camera that is a guess."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from instok3d.backbones.nano.common_points import CommonPoints

MATCHED_SHARE = 0.012
"""Two views overlap from this share of common points on. docs/log.md (2026-11-28) has the
measurement: 3 of 378 sets of overlapping photos are split, and lose 4 of 1,795 views; of 370 sets
with an odd view 358 are found."""
CONFIRMED_SHARE = 0.035
"""Solved cameras of two views are sure from this share of common points on that fit them; from
MATCHED_SHARE on they may be right. docs/log.md (2026-11-29) has the measurement."""
FEATURELESS_SHARE = 0.05
"""A photo with contrast in a smaller share of its pixels shows nothing: covered, dark,
overexposed."""


@dataclass(frozen=True)
class ViewChoice:
    """Which views a scene is made of."""

    kept: list[int]
    """In rising order, at least one."""
    notes: list[str]
    """Which views match no other, and what was done with them."""


def choose_matching_views(
    points: Sequence[CommonPoints],
    contrast: Float[Tensor, " view"],
    names: Sequence[str],
    *,
    posed: bool,
) -> ViewChoice:
    """The largest set of views that are linked by matches, directly or through other views.

    Other views are left out if cameras have to be solved for. With given cameras a view has a
    place even if it overlaps with no other, so only featureless views are left out. The same holds
    if no two views match, because then nothing tells which one is odd.

    Args:
        points: Of enough pairs to link all views, as `NanoBackbone.find_matches` chooses them.
        contrast: As `contrast_share` computes it.
        names: Of the photos.
        posed: Whether cameras were given.
    """
    views = range(len(names))
    linked = _linked(points, [pair.share for pair in points], MATCHED_SHARE, len(names))
    featureless = [view for view in views if float(contrast[view]) < FEATURELESS_SHARE]
    none_match = len(linked) == 1
    if none_match and len(featureless) == len(names):
        return ViewChoice(list(views), [_featureless_note(names)])
    unmatched = list(views) if none_match else [view for view in views if view not in linked]
    if len(names) == 1 or not unmatched:
        return ViewChoice(list(views), [])
    left_out = unmatched
    if posed or none_match:
        left_out = [view for view in unmatched if view in featureless]
    kept = [view for view in views if view not in left_out]
    notes = []
    if left_out:
        listed = _listed(names, left_out)
        notes.append(f"left out, as they match none of the other photos: {listed}")
    unchecked = [view for view in unmatched if view in kept]
    if unchecked and len(kept) > 1:
        notes.append(_unchecked_note(_listed(names, unchecked), posed))
    return ViewChoice(kept, notes)


def choose_confirmed_views(
    points: Sequence[CommonPoints], fits: Sequence[float], names: Sequence[str]
) -> ViewChoice:
    """The largest set of views whose solved cameras fit their matches, each with another's.

    Views of different places that look alike have matches too, and the solver finds some camera for
    them; but few of the matches fit it, as those with different views contradict each other. Such
    views are left out. Where no two views are left all stay, because nothing tells which are wrong.

    Args:
        points: As in `choose_matching_views`.
        fits: Share of each pair's points that fit the solved cameras.
        names: Of the photos.
    """
    shares = [pair.share * fit for pair, fit in zip(points, fits, strict=True)]
    kept = _linked(points, shares, MATCHED_SHARE, len(names))
    if len(names) == 1 or not points:
        return ViewChoice(list(range(len(names))), [])
    if len(kept) == 1:
        everyone = list(range(len(names)))
        matched = _linked(points, [pair.share for pair in points], MATCHED_SHARE, len(names))
        if len(matched) == 1:  # no two match, which `choose_matching_views` says
            return ViewChoice(everyone, [])
        return ViewChoice(everyone, [_guess_note(_listed(names, everyone))])
    sure = _linked(points, shares, CONFIRMED_SHARE, len(names))
    left_out = [view for view in range(len(names)) if view not in kept]
    unsure = [view for view in kept if view not in sure] if len(sure) > 1 else kept
    notes = []
    if left_out:
        notes.append(
            "left out, as no cameras fit their matches with the other photos (too far apart, or "
            f"of things that repeat): {_listed(names, left_out)}"
        )
    if unsure:
        notes.append(
            f"the cameras of these photos may be wrong, as few matches fit them: "
            f"{_listed(names, unsure)}; take photos in smaller steps"
        )
    return ViewChoice(kept, notes)


def _linked(
    points: Sequence[CommonPoints], shares: Sequence[float], least: float, count: int
) -> list[int]:
    """The largest set of views linked by pairs with at least such a share, in rising order.

    Of equally large sets that of the earliest view.
    """
    component = list(range(count))
    for pair, share in zip(points, shares, strict=True):
        if share >= least:
            old, new = component[pair.view_b], component[pair.view_a]
            component = [new if each == old else each for each in component]
    largest = max(component, key=lambda each: (component.count(each), -component.index(each)))
    return [view for view in range(count) if component[view] == largest]


def _featureless_note(names: Sequence[str]) -> str:
    return (
        f"nothing can be made out in any photo (covered, dark or overexposed): {', '.join(names)}; "
        "the scene is a guess"
    )


def _unchecked_note(listed: str, posed: bool) -> str:
    if posed:
        return (
            f"these photos match none of the others: {listed}; their cameras are used as given, "
            "and no other photo confirms their depth"
        )
    # Without given cameras unmatched views are kept only if no two views match.
    return (
        f"no two of these photos match: {listed}; their relative cameras are a guess: take photos "
        "that share half of what they show"
    )


def _guess_note(listed: str) -> str:
    return (
        f"no cameras fit the matches of these photos: {listed}; their relative cameras are a "
        "guess: take photos that share half of what they show"
    )


def _listed(names: Sequence[str], views: Sequence[int]) -> str:
    return ", ".join(names[view] for view in views)
