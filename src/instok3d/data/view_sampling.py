"""Which frames of a scene are context and which are target, in training and in the protocols."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

Sampling = Literal["rooms", "scannet", "re10k"]
"""rooms: `sample_two_views` and `sample_many_views`; scannet: `sample_scannet`; re10k:
`sample_re10k`."""
RE10K_GAPS = (45, 90)
"""Frames between the two contexts of RealEstate10K, smallest and largest (C3G)."""
RE10K_FIRST_GAP = 25
RE10K_WARM_UP_STEPS = 37_500
"""Steps over which the gap grows from the first to the final ones (C3G)."""


@dataclass(frozen=True)
class FrameChoice:
    """Frame numbers of one sample; the first context frame gives the world."""

    context: tuple[int, ...]
    target: tuple[int, ...]


def sample_frames(
    rng: np.random.Generator,
    num_frames: int,
    num_views: int,
    num_targets: int,
    *,
    sampling: Sampling = "rooms",
    step: int = 0,
) -> FrameChoice:
    """Frames of one training sample by the rule of a data set.

    Args:
        rng: Draws the frames.
        num_frames: Of the scene, numbered in the order of the path.
        num_views: Context views.
        num_targets: Target views; scannet and re10k give fewer where their rule has fewer.
        sampling: Which rule.
        step: Of the training run, for the growing gap of re10k.

    Raises:
        ValueError: The scene has fewer frames than `frames_needed`, or the rule has no samples of
            this many views or, in rooms, targets.
    """
    if sampling == "scannet":
        return sample_scannet(rng, num_frames, num_views=num_views, num_targets=num_targets)
    if sampling == "re10k":
        if num_views != 2:
            raise ValueError(f"samples of re10k have 2 context views, got {num_views}")
        return sample_re10k(rng, num_frames, num_targets=num_targets, step=step)
    if num_views == 2:
        return sample_two_views(rng, num_frames, num_targets=num_targets)
    return sample_many_views(rng, num_frames, num_views=num_views, num_targets=num_targets)


def frames_needed(num_views: int, sampling: Sampling) -> int:
    """The fewest frames with which a scene gives samples of this many context views."""
    return RE10K_GAPS[0] + 1 if sampling == "re10k" else 2 * num_views - 1


def sample_scannet(
    rng: np.random.Generator, num_frames: int, *, num_views: int, num_targets: int
) -> FrameChoice:
    """Contexts in order, all two or all four frames apart; targets from the middles between them.

    Uni3R's rule: the first and the last of 2 contexts are 2 or 4 frames apart, of 8 contexts 14
    or 28. Two contexts are targets themselves, after the frame in their middle; of more contexts
    only the middles are. Fewer num_targets take the first ones, or some middles in order.

    Raises:
        ValueError: Fewer than 2 views, or a scene of fewer than 2 num_views - 1 frames.
    """
    needed = frames_needed(num_views, "scannet")
    if num_views < 2 or num_frames < needed:
        raise ValueError(
            f"{num_views} context views two frames apart need at least 2 views and {needed} "
            f"frames, the scene has {num_frames}"
        )
    steps = [gap for gap in (2, 4) if gap * (num_views - 1) < num_frames]
    gap = steps[int(rng.integers(len(steps)))]
    first = int(rng.integers(num_frames - gap * (num_views - 1)))
    context = tuple(first + gap * k for k in range(num_views))
    middles = [k + gap // 2 for k in context[:-1]]
    if num_views == 2:
        return FrameChoice(context, (*middles, *context)[:num_targets])
    chosen = rng.choice(len(middles), size=min(num_targets, len(middles)), replace=False)
    return FrameChoice(context, tuple(middles[k] for k in sorted(chosen)))


def re10k_gaps(step: int) -> tuple[int, int]:
    """The smallest and the largest gap between the contexts at a step of training."""
    done = min(1.0, step / RE10K_WARM_UP_STEPS)
    low, high = (round(RE10K_FIRST_GAP + done * (gap - RE10K_FIRST_GAP)) for gap in RE10K_GAPS)
    return low, high


def sample_re10k(
    rng: np.random.Generator, num_frames: int, *, num_targets: int, step: int
) -> FrameChoice:
    """Two contexts in order, `re10k_gaps` apart; targets: a frame between them, then themselves.

    Raises:
        ValueError: The clip has fewer frames than `frames_needed`.
    """
    if num_frames < frames_needed(2, "re10k"):
        raise ValueError(
            f"a clip needs at least {frames_needed(2, 're10k')} frames, this one has {num_frames}"
        )
    low, high = re10k_gaps(step)
    gap = int(rng.integers(low, min(high, num_frames - 1), endpoint=True))
    first = int(rng.integers(num_frames - gap))
    context = (first, first + gap)
    new = int(rng.integers(first + 1, first + gap))
    return FrameChoice(context, (new, *context)[:num_targets])


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


def lsm_protocol(num_frames: int) -> list[FrameChoice]:
    """Two-view samples of LSM's ScanNet test: targets i with i mod 8 in {1, 4}, contexts i-1, i+1.

    A target whose next frame the scene does not have is left out; LSM's scenes have 30 frames
    and so 8 samples. Empty below three frames.
    """
    return [two_view_protocol(num_frames, center=i) for i in _every_eighth(num_frames, (1, 4), 1)]


def mipnerf360_protocol(num_frames: int) -> list[FrameChoice]:
    """Uni3R's MipNeRF360 samples: targets i with i mod 8 in {2, 6}, contexts i-2, i+2.

    Frames are in the order of COLMAP's image ids. The paper shows one target a scene; which one
    it does not say: take the middle one of these and report all beside it.
    """
    return [FrameChoice((i - 2, i + 2), (i,)) for i in _every_eighth(num_frames, (2, 6), 2)]


def _every_eighth(num_frames: int, remainders: tuple[int, ...], margin: int) -> list[int]:
    return [i for i in range(margin, num_frames - margin) if i % 8 in remainders]
