"""How well lifted features name the pixels of a scene, beside what they are compared with.

The rows of the paper's Table 4 (both levels of the features, each alone), the 2D encoder itself, a
perfect encoder on the groups as they are, and one feature for each Gaussian instead of each group.
The 2D encoder's row is LSeg's in the paper's Table 1; `method_features` measures other methods.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.data.sample import Sample, photos_only
from instok3d.evaluation.confusion import Confusion
from instok3d.evaluation.teachers import SemanticQuality, nearest_class, true_classes
from instok3d.geometry.camera_alignment import baseline_scale, cameras_in_prediction
from instok3d.model.tokenizer import Tokenizer
from instok3d.render import render
from instok3d.semantics.classes import LSM_CLASSES, LSM_OF_ROOM, PHRASES, ROOM_CLASSES
from instok3d.semantics.model import SemanticModel
from instok3d.semantics.teacher import Teacher
from instok3d.semantics.tokens import (
    SemanticMaps,
    SemanticTokens,
    pixel_features,
    render_semantics,
    turned,
)
from instok3d.types import Cameras, Gaussians, TokenGroups, Views

BOTH, GROUP, ANCHOR = "Group + Anchor", "Group", "Anchor"
FITTED = "Group + Anchor, fitted to the photos"
ENCODER, PERFECT = "2D encoder", "true class of each group"
GAUSSIANS, PIXELS = "one feature per Gaussian", "one feature per pixel of the photos"
KINDS = (BOTH, GROUP, ANCHOR, FITTED, ENCODER, PERFECT, GAUSSIANS, PIXELS)

PIXELS_FACTOR = 2
"""Gaussians of the last kind for each pixel, each way: 131,072 for two photos of 128 x 128."""


@dataclass(frozen=True)
class LiftedScene:
    """A scene with features, at its context views and then its target views."""

    groups: TokenGroups
    tokens: SemanticTokens
    cameras: Cameras
    """Of all views in the predicted world, without a batch axis."""
    photos: Float[Tensor, "view 3 height width"]
    instances: Int[Tensor, "view height width"]
    """True ids."""
    encoder: Float[Tensor, "view feature row column"]
    """What the 2D encoder says of each photo."""
    num_context: int
    classes: Int[Tensor, "kind view height width"]
    """True ones, see `true_classes`."""


@runtime_checkable
class TrueViews(Protocol):
    """What is known of the views of a scene, contexts first."""

    @property
    def num_context(self) -> int:
        """How many are context views."""
        ...

    @property
    def classes(self) -> Int[Tensor, "kind view height width"]:
        """True ones, see `true_classes`."""
        ...


@dataclass
class LiftedFigures:
    """Of one kind of features."""

    source: SemanticQuality = field(default_factory=lambda: _nothing_counted())
    """In the context views."""
    target: SemanticQuality = field(default_factory=lambda: _nothing_counted())
    cosines: dict[str, list[float]] = field(default_factory=lambda: {"source": [], "target": []})
    """With the encoder's features, a mean over the pixels of each scene."""
    scalars: list[int] = field(default_factory=list)
    """Stored for each scene."""

    def add(
        self,
        features: Float[Tensor, "view feature row column"],
        wanted: Float[Tensor, "view feature height width"],
        phrases: Float[Tensor, "phrase feature"],
        truth: TrueViews,
    ) -> None:
        """Count one scene.

        Args:
            features: Of any length.
            wanted: What the 2D encoder says of each photo.
            phrases: Of ROOM_CLASSES.
            truth: Of the same views.
        """
        size = (wanted.shape[-2], wanted.shape[-1])
        named = nearest_class(features, phrases, size)
        whole = functional.interpolate(features, size, mode="bilinear")
        alike = functional.cosine_similarity(whole, wanted, dim=1).mean(dim=(1, 2))
        self.cosines["source"].append(float(alike[: truth.num_context].mean()))
        self.cosines["target"].append(float(alike[truth.num_context :].mean()))
        onto = torch.tensor(LSM_OF_ROOM)
        for view, found in enumerate(named):
            part = self.source if view < truth.num_context else self.target
            in_rooms, in_lsm = truth.classes[:, view]
            part.rooms.add(in_rooms, found)
            part.lsm.add(in_lsm, onto[found])


def _nothing_counted() -> SemanticQuality:
    return SemanticQuality(Confusion(ROOM_CLASSES), Confusion(LSM_CLASSES))


@torch.no_grad()
def lifted_scene(
    tokenizer: Tokenizer, model: SemanticModel, teacher: Teacher, sample: Sample
) -> LiftedScene:
    """The scene of a sample's bare context photos with its semantic tokens.

    Target cameras are brought into the predicted world by the context cameras alone.

    Raises:
        ValueError: The sample is no batch of one.
    """
    if len(sample.names) != 1:
        raise ValueError(f"lifting is measured on samples of one scene, got {len(sample.names)}")
    photos = torch.cat([sample.context.images[0], sample.target.images[0]])
    encoder = teacher.features(photos).float()
    count = sample.context.images.shape[1]
    shown = photos_only(sample.context)
    groups, tokens = model(tokenizer, shown, encoder[None, :count])
    predicted, true = groups.geometry.cameras.scene(0), _cameras(sample.context)
    placed = cameras_in_prediction(
        _cameras(sample.target), predicted_context=predicted, true_context=true,
        scale=baseline_scale(predicted.cam_from_world, true.cam_from_world),
    )  # fmt: skip
    instances = torch.cat([sample.context_instances[0], sample.target_instances[0]])
    return LiftedScene(
        groups, tokens, Cameras.concatenate([predicted, placed]), photos, instances, encoder,
        count, true_classes(instances, sample.words[0]),
    )  # fmt: skip


def feature_maps(
    scene: LiftedScene, kind: str, phrases: Float[Tensor, "phrase feature"]
) -> tuple[Float[Tensor, "view feature row column"], int]:
    """Features of a kind in all views, and how many numbers are stored for them.

    Args:
        scene: With its features.
        kind: One of KINDS.
        phrases: Of ROOM_CLASSES, for the perfect encoder.
    """
    if kind == ENCODER:
        return scene.encoder, 0
    if kind in (GAUSSIANS, PIXELS):
        found = scene.groups.gaussians.scene(0) if kind == GAUSSIANS else pixel_gaussians(scene)
        gaussians = _each_an_anchor(found)
        features = uplifted(gaussians, scene)
        return _rendered(gaussians, features, scene), features.numel()
    maps, tokens = _semantic_maps(scene), scene.tokens
    residuals = tokens.residuals.numel()
    shared = tokens.num_scalars - residuals
    if kind == PERFECT:
        tokens = _with_true_classes(scene, maps, phrases)
    elif kind == FITTED:
        tokens = _fitted(scene, maps)
    if kind in (GROUP, PERFECT):
        maps = SemanticMaps(maps.shares, 0 * maps.residuals)
    elif kind == ANCHOR:
        maps = SemanticMaps(0 * maps.shares, maps.residuals)
    both = shared + residuals
    stored = {BOTH: both, FITTED: both, GROUP: shared, ANCHOR: residuals, PERFECT: shared}
    return pixel_features(maps, tokens)[0], stored[kind]


@torch.no_grad()
def measure_lifting(
    scenes: Iterable[LiftedScene], teacher: Teacher, kinds: Sequence[str] = KINDS
) -> Mapping[str, LiftedFigures]:
    """Figures of kinds of features over scenes.

    Args:
        scenes: One after the other.
        teacher: Whose texts name the classes.
        kinds: Some of KINDS.
    """
    phrases = teacher.text(PHRASES)
    figures = {kind: LiftedFigures() for kind in kinds}
    for scene in scenes:
        size = (scene.photos.shape[-2], scene.photos.shape[-1])
        wanted = functional.interpolate(scene.encoder, size, mode="bilinear")
        for kind, into in figures.items():
            features, scalars = feature_maps(scene, kind, phrases)
            into.scalars.append(scalars)
            into.add(features, wanted, phrases, scene)
    return figures


def uplifted(gaussians: Gaussians, scene: LiftedScene) -> Float[Tensor, "gaussian feature"]:
    """A feature for each Gaussian: the mean of the encoder's over the context pixels it shows in.

    Weighted by how much of each pixel it has (as LUDVIG does it); zeros for one that shows nowhere.
    The weights are the gradient of the rendering in the features.
    """
    size = (scene.photos.shape[-2], scene.photos.shape[-1])
    wanted = functional.interpolate(scene.encoder[: scene.num_context], size, mode="bilinear")
    wanted = torch.cat([wanted, torch.ones_like(wanted[:, :1])], dim=1)
    with torch.enable_grad():
        features = wanted.new_zeros(len(gaussians.means), wanted.shape[1], requires_grad=True)
        seen = _render(
            gaussians, features, scene.cameras.map(lambda v: v[: scene.num_context]), size
        )
        (sums,) = torch.autograd.grad((seen * wanted).sum(), features)
    return sums[:, :-1] / sums[:, -1:].clamp_min(1e-6)


def pixel_gaussians(scene: LiftedScene) -> Gaussians:
    """A small Gaussian for each pixel of the enlarged context photos, where their depth puts it."""
    geometry = scene.groups.geometry
    height, width = (PIXELS_FACTOR * side for side in scene.photos.shape[-2:])
    points = functional.interpolate(
        geometry.pointmaps[0].float().movedim(-1, 1), (height, width), mode="bilinear"
    )
    means = points.movedim(1, -1).flatten(0, 2)
    depths = functional.interpolate(geometry.depths[0].float()[:, None], (height, width))[:, 0]
    focal = geometry.cameras.intrinsics[0, :, 0, 0].float() * PIXELS_FACTOR
    radius = (0.5 * depths / focal[:, None, None]).flatten()
    count = len(means)
    return Gaussians(
        means, means.new_tensor([1.0, 0, 0, 0]).expand(count, 4), radius[:, None].expand(count, 3),
        means.new_full((count,), 0.95), means.new_zeros(count, 1, 3),
        torch.arange(count),
    )  # fmt: skip


def table(figures: Mapping[str, LiftedFigures]) -> str:
    """Markdown, a row for each kind."""
    lines = [
        "| features | LSM-8 mIoU / accuracy, source | target | all classes mIoU / accuracy, source "
        "| target | cosine to the encoder, source | target | numbers stored |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind, found in figures.items():
        pairs = [
            f"{each.mean_iou():.3f} / {each.accuracy():.3f}"
            for each in (found.source.lsm, found.target.lsm, found.source.rooms, found.target.rooms)
        ]
        cosines = [_mean(found.cosines[part]) for part in ("source", "target")]
        cells = [kind, *pairs, *(f"{each:.3f}" for each in cosines), f"{_mean(found.scalars):,.0f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _mean(values: Sequence[float] | Sequence[int]) -> float:
    return sum(values) / len(values) if values else float("nan")


def _cameras(views: Views) -> Cameras:
    assert views.cam_from_world is not None
    assert views.intrinsics is not None
    return Cameras(views.cam_from_world[0], views.intrinsics[0])


def _semantic_maps(scene: LiftedScene) -> SemanticMaps:
    height, width = scene.photos.shape[-2:]
    return render_semantics(
        scene.groups.gaussians, scene.groups.assignment.float(), scene.tokens,
        scene.cameras.batched(), height, width,
    )  # fmt: skip


def _with_true_classes(
    scene: LiftedScene, maps: SemanticMaps, phrases: Float[Tensor, "phrase feature"]
) -> SemanticTokens:
    """Shared features that are the phrase of the class that has most of each group's pixels."""
    shares, truth = maps.shares[0].sum(dim=2), scene.classes[0]
    known = truth >= 0
    onto = functional.one_hot(truth.clamp_min(0), len(phrases)).float() * known[..., None]
    counts = torch.einsum("vghw,vhwc->gc", shares, onto)
    named = phrases[counts.argmax(dim=1)].to(shares)
    basis = scene.tokens.shared.shape[2]
    return SemanticTokens(
        named[None, :, None].expand(-1, -1, basis, -1), scene.tokens.residuals,
        scene.tokens.mixing, scene.tokens.residual_map,
    )  # fmt: skip


def _fitted(scene: LiftedScene, maps: SemanticMaps) -> SemanticTokens:
    """Shared features that solve the second term of Eq. 8 in the context views; lengths stay.

    `Lifting.fitted` does so with the objects of a scene; of several shared features, as there, the
    mean is fitted and each differs from it as before.
    """
    shares = maps.shares[0, : scene.num_context]
    of_basis = shares.sum(dim=(0, 3, 4))
    of_basis = of_basis / of_basis.sum(dim=1, keepdim=True).clamp_min(1e-9)
    shares = shares.sum(dim=2)
    size = (shares.shape[-2], shares.shape[-1])
    seen = functional.interpolate(scene.encoder[: scene.num_context], size, mode="bilinear")
    mean = torch.einsum("vghw,vdhw->gd", shares, functional.normalize(seen, dim=1))
    shared = scene.tokens.shared[0]
    before = torch.einsum("gk,gkd->gd", of_basis, shared)
    shown = shares.sum(dim=(0, 2, 3)) > 0
    fitted = turned(shared, before, mean, shown)
    return SemanticTokens(
        fitted[None], scene.tokens.residuals, scene.tokens.mixing, scene.tokens.residual_map
    )


def _each_an_anchor(gaussians: Gaussians) -> Gaussians:
    """Gaussians whose features are their own."""
    own = torch.arange(len(gaussians.means))
    return Gaussians(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh, own
    )


def _rendered(
    gaussians: Gaussians, features: Float[Tensor, "gaussian feature"], scene: LiftedScene
) -> Float[Tensor, "view feature height width"]:
    return _render(gaussians, features, scene.cameras, tuple(scene.photos.shape[-2:]))


def _render(
    gaussians: Gaussians, features: Tensor, cameras: Cameras, size: Sequence[int]
) -> Float[Tensor, "view feature height width"]:
    rendering = render(gaussians, cameras, *size, anchor_features=features)
    assert rendering.features is not None
    return rendering.features
