"""How well the features of any method's scenes name pixels, as `semantic_lifting` counts them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.data.sample import Sample
from instok3d.evaluation.methods import Method, show
from instok3d.evaluation.semantic_lifting import LiftedFigures
from instok3d.evaluation.teachers import true_classes
from instok3d.geometry.camera_alignment import baseline_scale, cameras_in_prediction
from instok3d.semantics.classes import PHRASES
from instok3d.semantics.teacher import Teacher
from instok3d.types import Cameras, Views


@dataclass(frozen=True)
class TrueClasses:
    """What is true of the views of a sample, contexts first."""

    num_context: int
    classes: Int[Tensor, "kind view height width"]
    """See `true_classes`."""


@dataclass(frozen=True)
class SeenFeatures:
    """What a method's scene shows in the views of a sample, contexts first."""

    maps: Float[Tensor, "view feature row column"]
    """In the 2D encoder's space."""
    wanted: Float[Tensor, "view feature row column"]
    """What the encoder says of each photo."""
    truth: TrueClasses
    scalars: int
    """Numbers stored for the features of the scene."""


@torch.no_grad()
def seen_features(method: Method, sample: Sample, teacher: Teacher) -> SeenFeatures:
    """Features of a method's scene of bare photos, at all views of the sample.

    They are rendered at the predicted context cameras, and at the target cameras brought into the
    predicted world by these alone.

    Args:
        method: Whose scenes have features in the teacher's space.
        sample: A batch of one, with words.
        teacher: The 2D encoder.

    Raises:
        ValueError: The sample is no batch of one, or its scene has no features.
    """
    if len(sample.names) != 1:
        raise ValueError(f"features are measured scene by scene, got {len(sample.names)}")
    scene = method.fit(show(sample, method.needs))
    photos = torch.cat([sample.context.images[0], sample.target.images[0]])
    size = (photos.shape[-2], photos.shape[-1])
    true = _cameras(sample.context)
    placed = cameras_in_prediction(
        _cameras(sample.target), predicted_context=scene.cameras, true_context=true,
        scale=baseline_scale(scene.cameras.cam_from_world, true.cam_from_world),
    )  # fmt: skip
    maps = scene.at(Cameras.concatenate([scene.cameras, placed]), *size).rendering.features
    if maps is None:
        raise ValueError(f"the scene of {sample.names[0]} has no features to measure")
    instances = torch.cat([sample.context_instances[0], sample.target_instances[0]])
    truth = TrueClasses(len(true.intrinsics), true_classes(instances, sample.words[0]))
    wanted = functional.interpolate(teacher.features(photos).float(), size, mode="bilinear")
    return SeenFeatures(maps, wanted, truth, scene.cost.feature_scalars)


def measure_features(
    method: Method,
    samples: Iterable[Sample],
    teacher: Teacher,
    on_sample: Callable[[Sample, SeenFeatures], None] | None = None,
) -> LiftedFigures:
    """Figures of a method over samples; see `seen_features`.

    Args:
        method: Whose scenes have features in the teacher's space.
        samples: Batches of one, with words.
        teacher: Whose texts name the classes.
        on_sample: Called with what was measured.
    """
    phrases, figures = teacher.text(PHRASES), LiftedFigures()
    for sample in samples:
        seen = seen_features(method, sample, teacher)
        figures.scalars.append(seen.scalars)
        figures.add(seen.maps, seen.wanted, phrases, seen.truth)
        if on_sample is not None:
            on_sample(sample, seen)
    return figures


def _cameras(views: Views) -> Cameras:
    if views.cam_from_world is None or views.intrinsics is None:
        raise ValueError("cameras are missing; an evaluation sample carries the true ones")
    return Cameras(views.cam_from_world[0], views.intrinsics[0])
