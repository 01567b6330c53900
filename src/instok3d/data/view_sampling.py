"""Which frames of a scene are context and which are target, in training and in the protocols."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FrameChoice:
    """Frame numbers of one sample; the first context frame gives the world."""

    context: tuple[int, ...]
    target: tuple[int, ...]


def sample_two_views(
    rng: np.random.Generator,
    num_frames: int,
    *,
    num_targets: int = 2,
    gaps: tuple[int, ...] = (1, 2, 3, 4),
    gap_weights: tuple[float, ...] = (0.1, 0.7, 0.1, 0.1),
) -> FrameChoice:
    """Two context frames, mostly two apart, in random order, and one to three targets.

    The first target lies between the contexts, or one frame outside them in one case of five
    and when they are adjacent. The second and third are the context views themselves (the paper
    supervises contexts and target with two views).

    Raises:
        ValueError: The scene has fewer than three frames, or num_targets is not 1, 2 or 3.
    """
    if num_frames < 3:
        raise ValueError(f"a two-view sample needs at least 3 frames, the scene has {num_frames}")
    if not 1 <= num_targets <= 3:
        raise ValueError(f"two views have 1 to 3 targets (one new, two given), got {num_targets}")
    usable = [(g, w) for g, w in zip(gaps, gap_weights, strict=True) if g < num_frames]
    weights = np.array([w for _, w in usable])
    gap = usable[rng.choice(len(usable), p=weights / weights.sum())][0]
    first = int(rng.integers(num_frames - gap))
    between = list(range(first + 1, first + gap))
    outside = [k for k in (first - 1, first + gap + 1) if 0 <= k < num_frames]
    near = rng.random() < 0.2 or not between
    pool = outside if near and outside else between
    new = pool[rng.integers(len(pool))]
    context = tuple(int(k) for k in rng.permutation([first, first + gap]))
    given = tuple(int(k) for k in rng.permutation(context))
    return FrameChoice(context, (new, *given)[:num_targets])


def sample_many_views(
    rng: np.random.Generator, num_frames: int, *, num_views: int, num_targets: int = 2
) -> FrameChoice:
    """Every other frame as context, in random direction; targets from the frames between.

    Where more targets are asked for than frames lie between, context frames fill the rest.

    Raises:
        ValueError: Fewer than 2 views, or the scene is too short for every other frame.
    """
    span = 2 * (num_views - 1) + 1
    if num_views < 2 or span > num_frames:
        raise ValueError(
            f"{num_views} context views two frames apart need 3 to {num_frames} frames, "
            f"got a span of {span}"
        )
    first = int(rng.integers(num_frames - span + 1))
    context = list(range(first, first + span, 2))
    between = list(range(first + 1, first + span, 2))
    targets = [*rng.permutation(between), *rng.permutation(context)][:num_targets]
    if rng.random() < 0.5:
        context.reverse()
    return FrameChoice(tuple(context), tuple(int(k) for k in targets))


def two_view_protocol(num_frames: int, *, center: int | None = None) -> FrameChoice:
    """Contexts i-1 and i+1, target i; i is the middle frame unless it is given.

    Raises:
        ValueError: i-1 or i+1 is not a frame of the scene.
    """
    center = num_frames // 2 if center is None else center
    if not 1 <= center <= num_frames - 2:
        raise ValueError(
            f"center must be in 1..{num_frames - 2} (frames i-1, i, i+1), got {center}"
        )
    return FrameChoice((center - 1, center + 1), (center,))


def eight_view_protocol(num_frames: int) -> FrameChoice:
    """Contexts 0, 2, ... 14; targets the seven frames between them.

    Raises:
        ValueError: The scene has fewer than 15 frames.
    """
    if num_frames < 15:
        raise ValueError(f"the eight-view protocol needs 15 frames, the scene has {num_frames}")
    return FrameChoice(tuple(range(0, 15, 2)), tuple(range(1, 15, 2)))
