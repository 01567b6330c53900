"""Scenes in which each Gaussian has a feature, and the models that make them in one pass."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.backbones.base import GeometryBackbone
from instok3d.render import render
from instok3d.types import Cameras, Flow, Gaussians, Geometry, Rendering, Views


@dataclass(frozen=True)
class FeatureScene(Flow):
    """A batch of scenes; no Gaussian knows its instance."""

    gaussians: Gaussians
    """Scene units, first camera's frame; each its own anchor."""
    features: Float[Tensor, "batch gaussian channel"] | None
    """None where the model was not told what it makes them of."""
    feature_map: Float[Tensor, "feature channel"]
    """From channels to those of the 2D encoder; of the model, the same for all scenes."""
    geometry: Geometry
    """What the backbone says of the context views."""


@runtime_checkable
class FeatureModel(Protocol):
    """Photos in, a scene out; cameras and depth are those of its backbone."""

    backbone: GeometryBackbone
    config: Any
    """Its sizes, a frozen dataclass."""
    takes_features: bool
    """Whether it makes features of what a 2D encoder says of the context photos, or of these
    themselves."""
    detaches_gaussians: bool
    """Whether the loss of features leaves the Gaussians as they are."""

    def __call__(
        self,
        views: Views,
        encoded: Float[Tensor, "batch view feature row column"] | None = None,
        geometry: Geometry | None = None,
    ) -> FeatureScene:
        """A scene of each set of photos.

        Args:
            views: Context photos.
            encoded: What a 2D encoder says of them, at any resolution.
            geometry: The backbone's output for them where it was computed before.
        """
        ...


def render_scene(
    scene: FeatureScene, cameras: Cameras, height: int, width: int, *, detach: bool
) -> Rendering:
    """Pictures, and the channels of features composited as colours are.

    Args:
        scene: With or without features.
        cameras: In its world.
        height: Of the pictures, pixels.
        width: Likewise.
        detach: Gradients of features do not reach the Gaussians.
    """
    if not detach or scene.features is None:
        return render(scene.gaussians, cameras, height, width, anchor_features=scene.features)
    rendering = render(scene.gaussians, cameras, height, width)
    still = scene.gaussians.map(Tensor.detach)
    features = render(still, cameras, height, width, anchor_features=scene.features).features
    return Rendering(**{**vars(rendering), "features": features})


def own_anchors(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians, each its own anchor."""
    index = torch.arange(gaussians.means.shape[1], device=gaussians.means.device)
    own = index.expand(gaussians.means.shape[:2])
    return Gaussians(**{**vars(gaussians), "anchor_index": own})
