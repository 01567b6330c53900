"""Models of scenes with a feature for each Gaussian, as methods that are measured."""

from dataclasses import dataclass
from time import perf_counter

import torch

from instok3d.baselines.feature_scene import FeatureModel
from instok3d.evaluation.methods import Cost, FittedScene, Need, Shown
from instok3d.evaluation.tokenizer_method import NEEDS, GeometryMode
from instok3d.semantics.teacher import Teacher


@dataclass(frozen=True)
class FeatureMethod:
    """One forward pass."""

    model: FeatureModel
    """In eval mode."""
    mode: GeometryMode = "predicted"
    """What of the context views the model sees."""
    teacher: Teacher | None = None
    """The 2D encoder that it was trained with; a model that takes its features has none without."""

    @property
    def needs(self) -> frozenset[Need]:
        """By the mode."""
        return NEEDS[self.mode]

    @torch.no_grad()
    def fit(self, shown: Shown) -> FittedScene:
        """The scene that the model makes of the photos.

        Raises:
            ValueError: The model's answer is not finite.
        """
        started = perf_counter()
        encoded = None
        if self.teacher is not None and self.model.takes_features:
            encoded = self.teacher.features(shown.views.images[0]).float()[None]
        scene = self.model(shown.views, encoded)
        gaussians = scene.gaussians.scene(0)
        wrong = [name for name, value in vars(gaussians).items() if not value.isfinite().all()]
        if wrong:
            raise ValueError(
                "the model's answer is not finite: look for NaN in the model's weights; not "
                f"finite are {', '.join(wrong)}"
            )
        features = None if scene.features is None else scene.features[0]
        stored = 0 if features is None else features.numel()
        count = len(gaussians.means)
        return FittedScene(
            gaussians=gaussians,
            assignment=None,
            cameras=scene.geometry.cameras.scene(0),
            cost=Cost(count, 0 if features is None else count, 0, perf_counter() - started, stored),
            geometry=scene.geometry,
            features=features,
            feature_map=None if features is None else scene.feature_map.detach(),
        )
