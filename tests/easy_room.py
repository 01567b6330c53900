"""An easy room for methods that optimise a scene, and how well they know its context views."""

from dataclasses import replace

import torch

from fake_rooms import FakeRooms
from instok3d.baselines.settings import DensitySettings, SplatSettings
from instok3d.data.batches import make_sample
from instok3d.data.sample import Sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.evaluation.methods import FittedScene, Shown, show

SIZE = 64
QUICK = SplatSettings(
    steps=160,
    points=3000,
    rates=replace(SplatSettings().rates, sh_constant=1e-2, log_scales=1e-2, opacity_logits=0.1),
    density=DensitySettings(every=20, most=5000, reset_at=0.125),
)
"""Enough for the easy room at its size."""


def easy_sample() -> Sample:
    """Three boxes in a room, four context views and a target."""
    return make_sample(FakeRooms(1, size=SIZE), 0, FrameChoice((2, 6, 10, 14), (8,)))


def easy_shown(sample: Sample) -> Shown:
    """The context views with all that a method may need; the walls are a thing like the boxes."""
    masks = sample.context_instances[0] + 1
    return show(sample, frozenset({"cameras", "depth", "masks"}), masks)


def own_quality(scene: FittedScene, shown: Shown) -> tuple[float, float]:
    """PSNR of the context views in dB, and mean IoU of their masks; NaN without masks."""
    with torch.no_grad():
        seen = scene.at(shown.cameras, SIZE, SIZE)
    error = (seen.rendering.colors.clamp(0, 1) - shown.views.images[0]).square().mean()
    if seen.masks is None or shown.masks is None:
        return float(-10 * error.log10()), float("nan")
    columns = torch.stack([torch.from_numpy(each.ids) for each in seen.masks])
    names = shown.masks[shown.masks > 0].unique().tolist()
    ious = []
    for place, name in enumerate(names):
        predicted, true = columns == place, shown.masks == name
        ious.append(float((predicted & true).sum() / (predicted | true).sum()))
    return float(-10 * error.log10()), sum(ious) / len(ious)
