"""Training batches as a pure function of (seed, step, rank): no state to save or restore."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from instok3d.data.photometric import photometric_change
from instok3d.data.sample import Sample, collate
from instok3d.data.scenes import SceneSource
from instok3d.data.view_sampling import FrameChoice, sample_many_views, sample_two_views
from instok3d.geometry.cameras import invert_rigid, relative_to_first
from instok3d.types import Views


@dataclass(frozen=True)
class BatchConfig:
    """What a training batch holds."""

    batch_size: int = 4
    """Two-view samples a process sees in one step; with V views it is 2 batch_size / V."""
    views: tuple[int, ...] = (2,)
    """Numbers of context views; each step draws one. (2, 2, 2, 4, 8) has 2 in three of five."""
    num_targets: int = 2
    """Target views of a sample: one new frame, then context frames (two views: at most 3)."""
    photometric: bool = True
    """Change exposure, contrast and white balance scene by scene, and add noise to contexts."""

    def __post_init__(self):
        if self.batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {self.batch_size}")
        if not self.views or min(self.views) < 2:
            raise ValueError(f"views must hold numbers of at least 2, got {self.views}")
        if self.num_targets < 1:
            raise ValueError(f"num_targets must be at least 1, got {self.num_targets}")


class SceneBatches:
    """Batches by step. Equal arguments give equal bytes, whatever was asked for before.

    The global batch of a step is cut into one part for each rank, so the samples of a two-view
    step depend on batch_size * world_size alone; a step of more views leaves out the last places
    of each part. Every epoch goes through all scenes in a new order.

    Args:
        source: The scenes.
        scenes: Numbers of the scenes to draw from.
        seed: Chooses order, frames and photometric changes.
        rank: This process, of world_size.
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
    ) -> None:
        if not scenes:
            raise ValueError("SceneBatches needs at least one scene, got an empty list")
        if not 0 <= rank < world_size:
            raise ValueError(f"rank must be in 0..{world_size - 1}, got {rank}")
        self.source = source
        self.scenes = tuple(scenes)
        self.config = config
        self.seed = seed
        self.rank = rank
        self.world_size = world_size
        self._epoch_order = lru_cache(maxsize=2)(self._make_epoch_order)

    def batch(self, step: int) -> Sample:
        """This rank's part of the batch of one step."""
        views = int(np.random.default_rng([self.seed, 0, step]).choice(self.config.views))
        size = max(1, self.config.batch_size * 2 // views)
        # Places are counted as if every step had two views: the numbers of later steps then do
        # not depend on what earlier steps drew.
        first = (step * self.world_size + self.rank) * self.config.batch_size
        return collate([self._sample(first + place, views) for place in range(size)])

    def iterate(self, first_step: int) -> Iterator[tuple[int, Sample]]:
        """(step, batch) from first_step on without end; one batch ahead is read in a thread."""
        with ThreadPoolExecutor(max_workers=1) as reader:
            step, ahead = first_step, reader.submit(self.batch, first_step)
            while True:
                sample = ahead.result()
                ahead = reader.submit(self.batch, step + 1)
                yield step, sample
                step += 1

    def _make_epoch_order(self, epoch: int) -> np.ndarray:
        return np.random.default_rng([self.seed, 1, epoch]).permutation(len(self.scenes))

    def _sample(self, place: int, views: int) -> Sample:
        epoch, position = divmod(place, len(self.scenes))
        index = self.scenes[self._epoch_order(epoch)[position]]
        rng = np.random.default_rng([self.seed, 2, place])
        num_frames, targets = self.source.num_frames(index), self.config.num_targets
        if views == 2:
            choice = sample_two_views(rng, num_frames, num_targets=targets)
        else:
            choice = sample_many_views(rng, num_frames, num_views=views, num_targets=targets)
        photometric_rng = rng if self.config.photometric else None
        return make_sample(self.source, index, choice, photometric_rng=photometric_rng)


def make_sample(
    source: SceneSource,
    number: int,
    choice: FrameChoice,
    *,
    photometric_rng: np.random.Generator | None = None,
) -> Sample:
    """The chosen frames of a scene as a batch of one, cameras relative to the first context.

    Args:
        source: Scenes with cameras, depth and ids.
        number: Which scene.
        choice: Its context and target frames; each is read once.
        photometric_rng: Draws a photometric change; None leaves the images as they are.
    """
    frames = choice.context + choice.target
    read = sorted(set(frames))
    scene = source.frames(number, read)
    order = torch.tensor([read.index(frame) for frame in frames])
    num_context = len(choice.context)
    images = scene.images[order].permute(0, 3, 1, 2).float() / 255
    context_images, target_images = images[:num_context], images[num_context:]
    if photometric_rng is not None:
        context_images, target_images = photometric_change(
            photometric_rng, context_images, target_images
        )
    # Inverted and chained in float64: a float32 inverse would cost 1e-6 m for nothing.
    world_from_cam = scene.world_from_cam[order].double()
    cam_from_world = relative_to_first(invert_rigid(world_from_cam)).float()
    intrinsics = scene.intrinsics[order].float()
    depths = scene.depths_m[order].float()
    instances = scene.instances[order].long()

    def views(images: torch.Tensor, part: slice) -> Views:
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
    )
