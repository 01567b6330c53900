"""The tokenizer, with and without refinement, as one of the methods that are measured."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal

from instok3d.evaluation.methods import FAR, NEAR, Cost, FittedScene, Need, Shown
from instok3d.evaluation.seen_size import geometry_at, views_at
from instok3d.refinement.assignment import reassigned
from instok3d.refinement.optimization import refine_gaussians
from instok3d.refinement.settings import RefinementSettings
from instok3d.scene.clean_up import cleaned
from instok3d.scene.record import SceneTokens
from instok3d.types import TokenGroups, Views

GeometryMode = Literal["predicted", "intrinsics", "given"]
"""'predicted': the model sees bare photos. 'intrinsics': photos and their true intrinsics, as the
paper's model does. 'given': true cameras and depth too."""

Model = Callable[[Views], TokenGroups]
"""A Tokenizer, or whatever answers like one."""

NEEDS: dict[GeometryMode, frozenset[Need]] = {
    "predicted": frozenset(),
    "intrinsics": frozenset({"intrinsics"}),
    "given": frozenset({"cameras", "depth"}),
}


@dataclass(frozen=True)
class TokenizerMethod:
    """One forward pass, then what `reconstruct` may do with its scene."""

    model: Model
    """In eval mode."""
    mode: GeometryMode = "predicted"
    """What of the context views the model sees."""
    refine: int = 0
    """Steps of refinement on the context photos, at the cameras of the prediction."""
    clean_up: bool = False
    """Make whole objects of the groups, as `reconstruct` does by default."""
    alpha_min: float = 0.0
    """Pixels covered no more than this belong to no group."""
    pixels: int | None = None
    """Height of the photos that the model sees, and that a refinement looks at; None: theirs."""

    @property
    def needs(self) -> frozenset[Need]:
        """By the mode."""
        return NEEDS[self.mode]

    def fit(self, shown: Shown) -> FittedScene:
        """The scene that the model makes of the photos.

        Raises:
            ValueError: The model's answer is not finite.
        """
        started = perf_counter()
        size = height, width = shown.views.images.shape[-2:]
        if self.pixels is not None:
            views = views_at(shown.views, self.pixels, round(self.pixels * width / height))
            shown = replace(shown, views=views)
        groups = self.model(shown.views)
        _check_finite(groups)
        scene = FittedScene(
            gaussians=groups.gaussians.scene(0),
            assignment=groups.assignment[0],
            cameras=groups.geometry.cameras.scene(0),
            cost=Cost(0, 0, 0, 0.0),
            geometry=groups.geometry,
            alpha_min=self.alpha_min,
        )
        if self.refine:
            scene = self._refined(scene, groups, shown)
        if self.clean_up:
            scene = _cleaned(scene, groups, shown)
        geometry = geometry_at(groups.geometry, *size)
        return replace(
            scene,
            geometry=geometry,
            cameras=geometry.cameras.scene(0),
            cost=_cost(scene, groups, perf_counter() - started),
        )

    def _refined(self, scene: FittedScene, groups: TokenGroups, shown: Shown) -> FittedScene:
        assert scene.assignment is not None
        height, width = shown.views.images.shape[-2:]
        refined = refine_gaussians(
            scene.gaussians, scene.cameras, shown.views.images[0],
            RefinementSettings(steps=self.refine), near=NEAR, far=FAR,
        )  # fmt: skip
        gaussians = reassigned(
            refined.gaussians, scene.assignment, groups.anchors.positions[0], scene.cameras,
            height, width, near=NEAR, far=FAR,
        )  # fmt: skip
        return replace(scene, gaussians=gaussians)


def _cleaned(scene: FittedScene, groups: TokenGroups, shown: Shown) -> FittedScene:
    assert scene.assignment is not None
    height, width = shown.views.images.shape[-2:]
    tokens = SceneTokens(
        groups.anchors.positions[0], groups.anchors.tokens[0], groups.tokens[0], scene.assignment
    )
    whole = cleaned(scene.gaussians, tokens, scene.cameras, height, width, near=NEAR, far=FAR)
    return replace(scene, gaussians=whole.gaussians, assignment=whole.tokens.assignment)


def _cost(scene: FittedScene, groups: TokenGroups, seconds: float) -> Cost:
    return Cost(
        gaussians=len(scene.gaussians.means),
        semantic_units=scene.num_groups_used() or 0,
        label_scalars=groups.assignment[0].numel(),
        fit_s=seconds,
    )


def _check_finite(groups: TokenGroups) -> None:
    """A renderer leaves out what is not finite, so the picture alone would not tell.

    Points and features may be so: who uses them knows that some are unknown.
    """
    geometry = groups.geometry
    parts = {
        **vars(groups.gaussians),
        "assignment": groups.assignment,
        "depths": geometry.depths,
        **{f"{part} of the cameras": value for part, value in vars(geometry.cameras).items()},
    }
    wrong = [part for part, values in parts.items() if not values.isfinite().all()]
    if wrong:
        raise ValueError(
            "the model's answer is not finite: look for NaN in the model's weights; not finite are "
            f"{', '.join(wrong)}"
        )
