"""One training or test example: context views that are given, target views that are asked for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.data.view_sampling import FrameChoice
from instok3d.data.words import ObjectWords
from instok3d.types import Views


@dataclass(frozen=True)
class Sample:
    """A batch of scenes, float32; world = the camera of each first context view.

    Lengths are in metres, or in distances of the first two contexts (`BatchConfig.unit`).

    Both Views carry intrinsics, cam_from_world and depths; `photos_only` drops what a model that
    sees unposed photos must not know.
    """

    context: Views
    target: Views
    context_instances: Int[Tensor, "batch context height width"]
    """True ids: 0 = no instance, -1 = ignore; the same id is the same thing in every view."""
    target_instances: Int[Tensor, "batch target height width"]
    names: tuple[str, ...]
    """Where each sample came from, for messages and pictures."""
    keys: tuple[str, ...] = ()
    """One for each sample that is distinguishable from all others of its data set and comes again:
    scene/views/number. Empty where frames are drawn anew every time."""
    frames: tuple[FrameChoice, ...] = ()
    """Which frames of its scene each sample holds; empty where nobody said."""
    words: tuple[Mapping[int, ObjectWords], ...] = ()
    """Of instance ids, one mapping for each sample, empty where its data set knows none."""

    def __post_init__(self) -> None:
        if not self.words:
            object.__setattr__(self, "words", tuple({} for _ in self.names))

    def to(self, device: torch.device | str) -> "Sample":
        """The same sample with its tensors on another device."""
        return replace(
            self,
            context=self.context.to(device),
            target=self.target.to(device),
            context_instances=self.context_instances.to(device),
            target_instances=self.target_instances.to(device),
        )


def collate(samples: Sequence[Sample]) -> Sample:
    """One batch of all samples, in order.

    Raises:
        ValueError: There is no sample, or they differ in number of views, size or known fields.
    """
    if not samples:
        raise ValueError("collate needs at least one sample, got none")
    shapes = {(s.context.images.shape[1:], s.target.images.shape[1:]) for s in samples}
    if len(shapes) > 1:
        raise ValueError(f"samples of one batch must agree in views and size, got {shapes}")
    return Sample(
        context=_join_views([s.context for s in samples]),
        target=_join_views([s.target for s in samples]),
        context_instances=torch.cat([s.context_instances for s in samples]),
        target_instances=torch.cat([s.target_instances for s in samples]),
        names=tuple(name for s in samples for name in s.names),
        keys=tuple(key for s in samples for key in s.keys),
        frames=tuple(choice for s in samples for choice in s.frames),
        words=tuple(each for s in samples for each in s.words),
    )


def photos_only(views: Views, *, keep_intrinsics: bool = False) -> Views:
    """The views as bare photos: no cameras, no depth, and no intrinsics unless they are kept."""
    return Views(images=views.images, intrinsics=views.intrinsics if keep_intrinsics else None)


def _join_views(parts: Sequence[Views]) -> Views:
    joined: dict[str, Tensor | None] = {}
    for field in fields(Views):
        known = [t for part in parts if (t := getattr(part, field.name)) is not None]
        if len(known) not in (0, len(parts)):
            raise ValueError(f"{field.name} must be known in all samples of a batch or in none")
        joined[field.name] = torch.cat(known) if known else None
    return Views(**joined)  # pyright: ignore[reportArgumentType]
