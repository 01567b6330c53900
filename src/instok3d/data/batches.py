"""Training batches as a pure function of (seed, step, rank): no state to save or restore."""

import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import count
from typing import Literal
from zlib import crc32

import numpy as np
import torch
from torch import Tensor

from instok3d.data.mirror import mirror_sample
from instok3d.data.photometric import photometric_change
from instok3d.data.sample import Sample, collate
from instok3d.data.scenes import SceneSource
from instok3d.data.sensor import SensorConfig, sensor_change
from instok3d.data.view_sampling import (
    RE10K_WARM_UP_STEPS,
    FrameChoice,
    Sampling,
    frames_needed,
    sample_frames,
)
from instok3d.geometry.cameras import invert_rigid, relative_to_first
from instok3d.types import Views

MIN_BASELINE = 1e-3
"""Contexts that stand nearer to each other, in units of the data, give no unit of length."""
_DRAWS, _SCENES_TO_TRY = 5, 5

Unit = Literal["metre", "baseline"]


class NoBaselineError(ValueError):
    """The first two contexts stand at the same place, so their distance cannot be the unit."""


@dataclass(frozen=True)
class BatchConfig:
    """What a training batch holds."""

    batch_size: int = 4
    """Two-view samples a process sees in one step; with V views it is 2 batch_size / V."""
    views: tuple[int, ...] = (2,)
    """Numbers of context views; each step draws one. (2, 2, 2, 4, 8) has 2 in three of five."""
    num_targets: int = 2
    """Target views of a two-view sample: one new frame, then context frames (rooms: at most 3). A
    sample of V views has V / 2 times as many, so that every step renders equally many."""
    photometric: bool = True
    """Change exposure, contrast and white balance scene by scene, and add noise to contexts."""
    sensor: SensorConfig = field(default_factory=SensorConfig)
    """After that, what cameras do to each photo; off with strength 0."""
    mirror: bool = False
    """Mirror every other sample, by chance, left to right."""
    sampling: Sampling = "rooms"
    """Which frames make a sample; scannet as in Uni3R, re10k as in C3G (two views)."""
    unit: Unit = "metre"
    """baseline: lengths are divided by the distance of the first two contexts, which data of
    arbitrary scale needs (RealEstate10K); metre: they stay as the data has them."""
    samples_per_scene: int | None = None
    """None: each sample has new frames and new light. A number: a scene has so many fixed samples
    for each number of views, one more each epoch, then again; cached features need that."""

    def __post_init__(self):
        if self.batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {self.batch_size}")
        if not self.views or min(self.views) < 2:
            raise ValueError(f"views must hold numbers of at least 2, got {self.views}")
        if self.num_targets < 1:
            raise ValueError(f"num_targets must be at least 1, got {self.num_targets}")
        if self.sampling == "re10k" and set(self.views) != {2}:
            raise ValueError(f"samples of re10k have 2 context views, got views {self.views}")
        if self.samples_per_scene is not None and self.samples_per_scene < 1:
            raise ValueError(
                f"samples_per_scene must be None or at least 1, got {self.samples_per_scene}"
            )


class SceneBatches:
    """Batches by step. Equal arguments give equal bytes, whatever was asked for before.

    The global batch of a step is cut into `accumulate` parts for each rank, so the samples of a
    two-view step depend on batch_size * accumulate * world_size alone; a step of more views leaves
    out the last places of each part. Every epoch goes through all scenes in a new order. Scenes
    with too few frames for a sample are left out with a warning.

    Args:
        source: The scenes.
        scenes: Numbers of the scenes to draw from.
        seed: Chooses order, frames and what light and cameras do to the photos.
        rank: This process, of world_size.
        accumulate: Parts of a step that a process takes one after the other.
    """

    def __init__(
        self,
        source: SceneSource,
        scenes: Sequence[int],
        config: BatchConfig,
        *,
        seed: int,
        rank: int = 0,
        world_size: int = 1,
        accumulate: int = 1,
    ) -> None:
        if not scenes:
            raise ValueError("SceneBatches needs at least one scene, got an empty list")
        if not 0 <= rank < world_size:
            raise ValueError(f"rank must be in 0..{world_size - 1}, got {rank}")
        if accumulate < 1:
            raise ValueError(f"accumulate must be at least 1, got {accumulate}")
        self.source = source
        self.scenes = _long_enough(source, scenes, config)
        self.config = config
        self.seed = seed
        self.rank = rank
        self.world_size = world_size
        self.accumulate = accumulate
        self._epoch_order = lru_cache(maxsize=2)(self._make_epoch_order)

    def batch(self, step: int, part: int = 0) -> Sample:
        """One of this rank's parts of the batch of a step."""
        views = int(np.random.default_rng([self.seed, 0, step]).choice(self.config.views))
        size = max(1, self.config.batch_size * 2 // views)
        # Places are counted as if every step had two views: the numbers of later steps then do
        # not depend on what earlier steps drew.
        parts = (step * self.world_size + self.rank) * self.accumulate + part
        first = parts * self.config.batch_size
        return collate([self._sample(first + place, views, step) for place in range(size)])

    def iterate(self, first_step: int, readers: int = 1) -> Iterator[tuple[int, list[Sample]]]:
        """(step, its parts) from first_step on without end, the same for any number of readers.

        Args:
            first_step: Where to begin.
            readers: Threads, each of which reads one part ahead.
        """
        if readers < 1:
            raise ValueError(f"readers must be at least 1, got {readers}")
        pool = ThreadPoolExecutor(readers)
        coming = ((step, part) for step in count(first_step) for part in range(self.accumulate))
        ahead = deque(pool.submit(self.batch, *next(coming)) for _ in range(readers))
        try:
            for step in count(first_step):
                parts = []
                for _ in range(self.accumulate):
                    parts.append(ahead.popleft().result())
                    ahead.append(pool.submit(self.batch, *next(coming)))
                yield step, parts
        finally:
            pool.shutdown(cancel_futures=True)

    def _make_epoch_order(self, epoch: int) -> np.ndarray:
        return np.random.default_rng([self.seed, 1, epoch]).permutation(len(self.scenes))

    def fixed_sample(self, number: int, views: int, which: int) -> Sample:
        """One of the samples of a scene that come again, with its key; it depends on its name.

        Args:
            number: Of the scene.
            views: Context views.
            which: Less than samples_per_scene.

        Raises:
            NoBaselineError: See `make_sample`.
        """
        name = self.source.name_of(number)
        rng = np.random.default_rng([self.seed, 3, crc32(name.encode()), views, which])
        # The gap of re10k is that of the end: a sample that comes again knows no step.
        sample = self._draw(rng, number, views, RE10K_WARM_UP_STEPS)
        return replace(sample, keys=(f"{name}/{views}/{which}",))

    def _sample(self, place: int, views: int, step: int) -> Sample:
        epoch, position = divmod(place, len(self.scenes))
        order = np.roll(self._epoch_order(epoch), -position)
        rng = np.random.default_rng([self.seed, 2, place])
        fixed = self.config.samples_per_scene
        for scene in order[:_SCENES_TO_TRY]:  # the first, unless its camera stands still
            try:
                if fixed is not None:
                    return self.fixed_sample(self.scenes[scene], views, epoch % fixed)
                return self._draw(rng, self.scenes[scene], views, step)
            except NoBaselineError as error:
                warnings.warn(f"{error}; the next scene is taken", stacklevel=2)
        raise NoBaselineError(
            f"the contexts of {min(_SCENES_TO_TRY, len(order))} scenes one after the other stand "
            f"less than {MIN_BASELINE:g} apart; check the cameras of the data"
        )

    def _draw(self, rng: np.random.Generator, number: int, views: int, step: int) -> Sample:
        for _ in range(_DRAWS - 1):
            with suppress(NoBaselineError):
                return self._draw_once(rng, number, views, step)
        return self._draw_once(rng, number, views, step)

    def _draw_once(self, rng: np.random.Generator, number: int, views: int, step: int) -> Sample:
        config = self.config
        choice = sample_frames(
            rng,
            self.source.num_frames(number),
            views,
            config.num_targets * views // 2,
            sampling=config.sampling,
            step=step,
        )

        def as_photos(context: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
            if config.photometric:
                context, target = photometric_change(rng, context, target)
            return sensor_change(rng, config.sensor, context, target)

        sample = make_sample(self.source, number, choice, change=as_photos, unit=config.unit)
        return mirror_sample(sample) if config.mirror and rng.random() < 0.5 else sample


def _long_enough(
    source: SceneSource, scenes: Sequence[int], config: BatchConfig
) -> tuple[int, ...]:
    needed = frames_needed(max(config.views), config.sampling)
    kept = tuple(number for number in scenes if source.num_frames(number) >= needed)
    if not kept:
        raise ValueError(
            f"all {len(scenes)} scenes have fewer than the {needed} frames that a sample of "
            f"{max(config.views)} views needs (sampling {config.sampling!r})"
        )
    if len(kept) < len(scenes):
        warnings.warn(
            f"{len(scenes) - len(kept)} of {len(scenes)} scenes are left out: they have fewer "
            f"than the {needed} frames that a sample needs",
            stacklevel=3,
        )
    return kept


def make_sample(
    source: SceneSource,
    number: int,
    choice: FrameChoice,
    *,
    change: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]] | None = None,
    unit: Unit = "metre",
) -> Sample:
    """The chosen frames of a scene as a batch of one, cameras relative to the first context.

    Args:
        source: Scenes with cameras, depth and ids.
        number: Which scene.
        choice: Its context and target frames; each is read once.
        change: Makes others of the context and target images, "view 3 height width" in [0, 1];
            None leaves them as they are.
        unit: Of the cameras and depths in the sample: metre leaves them as the source has them.

    Raises:
        NoBaselineError: The unit is the baseline, and the first two contexts are closer than
            MIN_BASELINE.
    """
    frames = choice.context + choice.target
    read = sorted(set(frames))
    scene = source.frames(number, read)
    order = torch.tensor([read.index(frame) for frame in frames])
    num_context = len(choice.context)
    images = scene.images[order].permute(0, 3, 1, 2).float() / 255
    context_images, target_images = images[:num_context], images[num_context:]
    if change is not None:
        context_images, target_images = change(context_images, target_images)
    # Inverted and chained in float64: a float32 inverse would cost 1e-6 m for nothing.
    world_from_cam = scene.world_from_cam[order].double()
    cam_from_world = relative_to_first(invert_rigid(world_from_cam))
    depths = scene.depths_m[order].float()
    if unit == "baseline":
        baseline = (world_from_cam[1, :3, 3] - world_from_cam[0, :3, 3]).norm()
        if baseline < MIN_BASELINE:
            raise NoBaselineError(
                f"contexts {choice.context[0]} and {choice.context[1]} of scene {scene.name} stand "
                f"{float(baseline):.2g} apart"
            )
        cam_from_world[:, :3, 3] /= baseline
        depths = depths / baseline.float()
    cam_from_world = cam_from_world.float()
    intrinsics = scene.intrinsics[order].float()
    instances = scene.instances[order].long()

    def views(images: Tensor, part: slice) -> Views:
        return Views(
            images=images.contiguous()[None],
            intrinsics=intrinsics[part][None],
            cam_from_world=cam_from_world[part][None],
            depths=depths[part][None],
        )

    context, target = slice(num_context), slice(num_context, None)
    frame_names = ",".join(str(k) for k in choice.context)
    return Sample(
        context=views(context_images, context),
        target=views(target_images, target),
        context_instances=instances[context][None],
        target_instances=instances[target][None],
        names=(f"{scene.name} frames {frame_names}",),
        frames=(choice,),
        words=(scene.words,),
    )
