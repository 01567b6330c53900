"""What every method that is measured has in common: it is shown views, and shows others.

`Shown` -> `Method.fit` -> `FittedScene` -> `FittedScene.at(cameras, height, width)` -> `Seen`.
Where cameras are placed and how pictures are scored is no matter of the methods (`prediction.py`).
"""

from dataclasses import dataclass, replace
from typing import Literal, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.data.sample import Sample
from instok3d.evaluation.instance_ap import PredictedMasks, predicted_masks
from instok3d.render import render
from instok3d.types import Cameras, Gaussians, Geometry, Rendering, Views

Need = Literal["intrinsics", "cameras", "depth", "masks"]
"""What a method must be given beside the photos; cameras are poses with intrinsics."""

NEAR, FAR = 0.05, 100.0
"""z-depths between which scenes are fitted and rendered."""


@dataclass(frozen=True)
class Shown:
    """The context views of one scene, with what the method needs and no more."""

    views: Views
    """A batch of one."""
    masks: Int[Tensor, "view height width"] | None = None
    """Ids above 0, the same id the same thing in every view; 0 = no thing is known."""

    @property
    def cameras(self) -> Cameras:
        """Without the batch axis.

        Raises:
            ValueError: They are not shown.
        """
        views = self.views
        if views.cam_from_world is None or views.intrinsics is None:
            raise ValueError("the cameras of the context views are not shown; need 'cameras'")
        return Cameras(views.cam_from_world[0], views.intrinsics[0])


def show(
    sample: Sample,
    needs: frozenset[Need],
    masks: Int[Tensor, "view height width"] | None = None,
) -> Shown:
    """What a method that needs this gets to see of the context views of a sample.

    Args:
        sample: A batch of one.
        needs: Of the method.
        masks: Id maps of the context views; left out where they are not needed.

    Raises:
        ValueError: The sample lacks something, or masks are needed and there are none.
    """
    context = sample.context
    cameras = "cameras" in needs
    views = Views(
        images=context.images,
        intrinsics=context.intrinsics if cameras or "intrinsics" in needs else None,
        cam_from_world=context.cam_from_world if cameras else None,
        depths=context.depths if "depth" in needs else None,
    )
    if "masks" not in needs:
        return Shown(views)
    if masks is None:
        raise ValueError("the method needs masks of the context views, got none: say which")
    return Shown(views, masks)


@dataclass(frozen=True)
class Cost:
    """What a scene takes to make and to keep."""

    gaussians: int
    semantic_units: int
    """That carry instances or features of their own: groups of a tokenizer, else Gaussians or
    anchors; 0 where there are none."""
    label_scalars: int
    """Numbers stored to tell instances apart, beside the Gaussians."""
    fit_s: float
    """Wall-clock seconds from the photos to the scene."""
    feature_scalars: int = 0
    """Numbers stored for semantic features (`SemanticTokens.num_scalars`)."""
    peak_bytes: int | None = None
    """The most memory held while the scene was made (`peak_memory`); None = not measured."""


@dataclass(frozen=True)
class Seen:
    """A scene from some cameras."""

    rendering: Rendering
    """Unbatched; `features` are feature maps that the method has, None without any."""
    masks: tuple[PredictedMasks, ...] | None
    """Of each view, with confidences; None for a method that knows no instances."""


@dataclass(frozen=True)
class FittedScene:
    """A scene of Gaussians in the method's own world, of which some know their instance."""

    gaussians: Gaussians
    """Unbatched."""
    assignment: Float[Tensor, "anchor column"] | None
    """Probabilities of the groups for the anchor of each Gaussian, the void's last; None for a
    method that knows no instances."""
    cameras: Cameras
    """Of the context views in this world, unbatched."""
    cost: Cost
    geometry: Geometry | None = None
    """Where cameras and depth of the context views were predicted."""
    alpha_min: float = 0.0
    """Pixels covered no more than this belong to no group."""
    features: Float[Tensor, "anchor channel"] | None = None
    """Of the anchor of each Gaussian, for a method that has them and knows no instances."""
    feature_map: Float[Tensor, "feature channel"] | None = None
    """From channels to those of the 2D encoder; None where they are the same."""

    def at(self, cameras: Cameras, height: int, width: int) -> Seen:
        """Pictures, and instances where they are known: the argmax of the composited groups.

        A method that has features and no instances gives composited features instead.

        Args:
            cameras: In this world, unbatched.
            height: Of the pictures, pixels.
            width: Of the pictures, pixels.
        """
        shown = self.features
        if self.assignment is not None:
            shown = self.assignment[:, :-1].contiguous()
        rendering = render(
            self.gaussians, cameras, height, width, anchor_features=shown, near=NEAR, far=FAR
        )
        if rendering.features is None:
            return Seen(rendering, None)
        if self.assignment is None:
            return Seen(replace(rendering, features=self._decoded(rendering.features)), None)
        masks = self.masks_of(rendering.features, rendering.alphas)
        return Seen(replace(rendering, features=None), masks)

    def _decoded(
        self, maps: Float[Tensor, "view channel height width"]
    ) -> Float[Tensor, "view feature height width"]:
        if self.feature_map is None:
            return maps
        return torch.einsum("vchw,fc->vfhw", maps, self.feature_map)

    def masks_of(
        self,
        maps: Float[Tensor, "view group height width"],
        alphas: Float[Tensor, "view height width"],
    ) -> tuple[PredictedMasks, ...]:
        """Masks of each view from the score that each group has in each pixel."""
        return tuple(
            predicted_masks(each, alpha, alpha_min=self.alpha_min)
            for each, alpha in zip(maps, alphas, strict=True)
        )

    def num_groups_used(self) -> int | None:
        """Groups that win an anchor against each other and the void; None without instances."""
        if self.assignment is None:
            return None
        winners = self.assignment.argmax(dim=-1)
        return len(winners[winners < self.assignment.shape[1] - 1].unique())


@runtime_checkable
class Method(Protocol):
    """Makes a scene of context views, by prediction or by optimisation."""

    @property
    def needs(self) -> frozenset[Need]:
        """What it must be shown beside photos."""
        ...

    def fit(self, shown: Shown, /) -> FittedScene:
        """The scene.

        Raises:
            ValueError: Something that is needed is not shown, or no scene came out.
        """
        ...
