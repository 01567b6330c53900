"""Semantics of a new scene: what the 2D encoder of a model sees in the photos, lifted into it."""

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.model.tokenizer import Tokenizer
from instok3d.scene.labels import with_labels
from instok3d.scene.scene import Scene
from instok3d.scene.semantics import check_encoder, scene_semantics
from instok3d.semantics.files import load_semantics
from instok3d.semantics.labels import class_labels
from instok3d.semantics.model import PatchLift, SemanticModel
from instok3d.semantics.query.encoder import QueryEncoder
from instok3d.semantics.query.shipped import SHIPPED, load_encoder
from instok3d.semantics.teachers.file import holds_encoder
from instok3d.semantics.teachers.opening import open_teacher
from instok3d.semantics.tokens import turned
from instok3d.types import TokenGroups, Views

AUTO, NONE = "auto", "none"
MIN_PIXELS = 16
"""In all photos together: what is seen of an object that its shared feature is fitted to."""


@dataclass(frozen=True)
class Lifting:
    """An encoder, and what lifts its features into the scenes of one model."""

    encoder: QueryEncoder
    model: SemanticModel

    @torch.no_grad()
    def features(self, views: Views) -> Float[Tensor, "batch view feature row column"]:
        """What the encoder sees in photos, on the CPU."""
        found = self.encoder.teacher.features(views.images.flatten(0, 1).cpu())
        return found.unflatten(0, views.images.shape[:2]).float()

    @torch.no_grad()
    def of(
        self,
        tokenizer: Tokenizer,
        views: Views,
        features: Float[Tensor, "batch view feature row column"],
    ) -> PatchLift:
        """What the tokenizer carries through its windows, for photos on its device."""
        features = features.to(views.images)
        return self.model.to(views.images.device).lift(tokenizer, views, features)

    @torch.no_grad()
    def with_semantics(self, scene: Scene, groups: TokenGroups) -> Scene:
        """The scene with its semantic tokens.

        Args:
            scene: Before anything but its Gaussians has changed.
            groups: What it was made of, on the CPU.
        """
        found = scene_semantics(self.model.cpu().tokens(groups))
        name = check_encoder(self.encoder.teacher.name)
        return replace(scene, semantics={**scene.semantics, name: found})

    @torch.no_grad()
    def fitted(self, scene: Scene, features: Float[Tensor, "view feature row column"]) -> Scene:
        """The scene with the shared features that its own photos ask for.

        The second term of Eq. 8, solved for one scene as `refine` does with Gaussians: s points to
        the mean direction of the encoder's features over the pixels where the object is seen. Its
        length stays, and so does what residuals add. Of several shared features the mean does, and
        each differs from it as before: what tells parts apart is the model's. Objects that show
        fewer than MIN_PIXELS keep what the model gave.

        Args:
            scene: With its objects.
            features: Of its photos, as `features` gives them.
        """
        name = self.encoder.teacher.name
        one = scene.semantics[name]
        totals = one.shared.new_zeros(len(one.shared), features.shape[1])
        pixels = torch.zeros(len(one.shared))
        for view, each in enumerate(functional.normalize(features, dim=1)):
            masks = {
                item.id - 1: item.sight.masks[item.visible_in.index(view)].mask()
                for item in scene.objects
                if view in item.visible_in
            }
            if not masks:
                continue
            rows, seen = list(masks), torch.stack(list(masks.values())).float()
            whole = functional.interpolate(each[None], tuple(seen.shape[1:]), mode="bilinear")[0]
            totals[rows] += seen.flatten(1) @ whole.flatten(1).T
            pixels[rows] += seen.sum(dim=(1, 2))
        mean = one.of_groups(scene.tokens.assignment)
        shared = turned(one.shared, mean, totals, pixels >= MIN_PIXELS)
        better = replace(one, shared=shared.half().float())
        return replace(scene, semantics={**scene.semantics, name: better})

    def named(self, scene: Scene) -> Scene:
        """The scene with its objects named by what the encoder says of them.

        An encoder that reads no texts names nothing, with a warning.
        """
        name = self.encoder.teacher.name
        try:
            vocabulary = self.encoder.vocabulary
        except ValueError as error:
            warnings.warn(f"objects have no names: {error}", stacklevel=2)
            return scene
        ids = [item.id for item in scene.objects]
        vectors = scene.semantics[name].of_objects(ids, scene.tokens.assignment)
        labels = class_labels(vectors, vocabulary, self.encoder.calibration)
        return with_labels(scene, dict(zip(ids, labels, strict=True)), name)


def find_lifting(
    choice: str | Path, tokenizer: Tokenizer, *, default: bool, teacher: str | None = None
) -> Lifting | None:
    """What a model's scenes get their semantics from.

    Args:
        choice: "auto", that which comes with the default model; "none"; or a file.
        tokenizer: The model.
        default: Whether it is the default one; others have no semantics unless a file is given.
        teacher: The encoder that the file lifts the features of, as `open_teacher` takes it; None
            where the file holds it.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds no semantics of this model, or is damaged; or the encoder is another.
    """
    if teacher is not None and choice in (AUTO, NONE):
        raise ValueError(
            f"teacher {teacher!r} goes with a file of semantics, got semantics {choice!r}: give a "
            "file that `instok3d train export` wrote"
        )
    if choice == NONE or (choice == AUTO and not (default and SHIPPED.is_file())):
        return None
    path = SHIPPED if choice == AUTO else Path(choice)
    loaded = load_semantics(path, tokenizer)
    if teacher is None and not holds_encoder(path):
        raise ValueError(
            f"{path} lifts features of {loaded.encoder!r} and does not hold that encoder: give its "
            "weights (--teacher)"
        )
    encoder = load_encoder(path) if teacher is None else QueryEncoder(open_teacher(teacher))
    if loaded.encoder != encoder.teacher.name:
        raise ValueError(
            f"{path} lifts features of {loaded.encoder!r}, got the encoder "
            f"{encoder.teacher.name!r}: " + ("export it again" if teacher is None else
                                             "give the weights that it was trained with")
        )  # fmt: skip
    return Lifting(encoder, loaded.model)
