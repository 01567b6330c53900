"""Test samples whose context photos are disturbed as real ones are: always in the same way."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor
from torch.nn import functional as F

from instok3d.data.photo_effects import (
    Photos,
    with_gains,
    with_jpeg,
    with_motion_blur,
    with_noise,
    with_saturation,
)
from instok3d.data.sample import Sample
from instok3d.evaluation.protocols import ProtocolScene
from instok3d.types import Views

Disturbance = Literal[
    "jpeg30", "noise8", "exposure20", "focal1.33", "focal2", "grey", "overexposed", "hard"
]
DISTURBANCES: tuple[Disturbance, ...] = get_args(Disturbance)


def disturbed(scene: ProtocolScene, name: str) -> ProtocolScene:
    """The scene with its context photos disturbed; the targets stay what they were.

    jpeg30: JPEG of quality 30. noise8: noise of 8 / 255. exposure20: values of every other photo
    times 1.2, of the others times 0.8, the first one's chosen by chance. grey: no colour.
    overexposed: values times 1.6. hard: such exposures, the colours of each photo times up to 0.05
    more or less, blur along a line of 1.5 pixels at a height of 128, noise of 5 / 255 and JPEG of
    quality 50, in this order. Values are cut to [0, 1] each time.

    focal1.33 and focal2 take the centre of the pictures alone, enlarged, with cameras, depth and
    ids, of contexts and targets: what a lens with so many times the focal length sees.

    What is drawn follows from the name of the scene and the number of the sample alone.

    Raises:
        ValueError: There is no such disturbance.
    """
    if name not in DISTURBANCES:
        raise ValueError(f"the disturbance must be one of {', '.join(DISTURBANCES)}, got {name!r}")
    samples = []
    for number, sample in enumerate(scene.samples):
        rng = np.random.default_rng([crc32(scene.name.encode()), number])
        if name.startswith("focal"):
            samples.append(zoomed(sample, float(name.removeprefix("focal"))))
        else:
            images = torch.stack([_EFFECTS[name](each, rng) for each in sample.context.images])
            samples.append(replace(sample, context=replace(sample.context, images=images)))
    return replace(scene, samples=tuple(samples))


def zoomed(sample: Sample, factor: float) -> Sample:
    """The sample as lenses of `factor` times the focal length see it, at the same size.

    Colours are interpolated; depth and ids are those of the nearest pixel.
    """
    return replace(
        sample,
        context=_zoomed_views(sample.context, factor),
        target=_zoomed_views(sample.target, factor),
        context_instances=_nearest(sample.context_instances, factor),
        target_instances=_nearest(sample.target_instances, factor),
    )


def _zoomed_views(views: Views, factor: float) -> Views:
    height, width = views.images.shape[-2:]
    images = views.images.flatten(0, 1)
    scaling = images.new_tensor([[[1 / factor, 0, 0], [0, 1 / factor, 0]]])
    grid = F.affine_grid(scaling, [1, 3, height, width], align_corners=False)
    grid = grid.expand(len(images), -1, -1, -1)
    enlarged = F.grid_sample(images, grid, padding_mode="border", align_corners=False)
    intrinsics = views.intrinsics
    if intrinsics is not None:
        about_centre = intrinsics.new_tensor(
            [
                [factor, 0, width / 2 * (1 - factor)],
                [0, factor, height / 2 * (1 - factor)],
                [0, 0, 1],
            ]
        )
        intrinsics = about_centre @ intrinsics
    return replace(
        views,
        images=enlarged.unflatten(0, views.images.shape[:2]),
        intrinsics=intrinsics,
        depths=None if views.depths is None else _nearest(views.depths, factor),
    )


def _nearest(values: Tensor, factor: float) -> Tensor:
    """Each pixel's value is that of the pixel that its centre falls into."""
    rows, columns = (_sources(size, factor) for size in values.shape[-2:])
    return values[..., rows[:, None], columns]


def _sources(size: int, factor: float) -> Int[Tensor, " size"]:
    centres = (torch.arange(size, dtype=torch.float64) + 0.5 - size / 2) / factor + size / 2
    return centres.floor().long().clamp(0, size - 1)


def _exposed(photos: Photos, rng: np.random.Generator) -> Photos:
    sign = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(len(photos))
    return with_gains(photos, (1 + 0.2 * sign)[:, None]).clamp(0, 1)


def _noisy(photos: Photos, sigma: float, rng: np.random.Generator) -> Photos:
    sigmas = np.full(len(photos), sigma)
    return with_noise(photos, sigmas, sigmas, rng).clamp(0, 1)


def _hard(photos: Photos, rng: np.random.Generator) -> Photos:
    count = len(photos)
    photos = _exposed(photos, rng)
    photos = with_gains(photos, 1 + rng.uniform(-0.05, 0.05, (count, 3))).clamp(0, 1)
    photos = with_motion_blur(photos, np.full(count, 1.5), rng.uniform(0, np.pi, count))
    return with_jpeg(_noisy(photos, 5 / 255, rng), [50] * count)


_EFFECTS: dict[str, Callable[[Photos, np.random.Generator], Photos]] = {
    "jpeg30": lambda photos, rng: with_jpeg(photos, [30] * len(photos)),
    "noise8": lambda photos, rng: _noisy(photos, 8 / 255, rng),
    "exposure20": _exposed,
    "grey": lambda photos, rng: with_saturation(photos, 0.0),
    "overexposed": lambda photos, rng: (1.6 * photos).clamp(0, 1),
    "hard": _hard,
}
