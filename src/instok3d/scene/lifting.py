"""Semantics of a new scene: what the 2D encoder of a model sees in the photos, lifted into it."""

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import torch

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
from instok3d.types import TokenGroups, Views

AUTO, NONE = "auto", "none"


@dataclass(frozen=True)
class Lifting:
    """An encoder, and what lifts its features into the scenes of one model."""

    encoder: QueryEncoder
    model: SemanticModel

    @torch.no_grad()
    def of(self, tokenizer: Tokenizer, views: Views) -> PatchLift:
        """What the tokenizer carries through its windows, for photos on its device."""
        features = self.encoder.teacher.features(views.images.flatten(0, 1).cpu())
        features = features.unflatten(0, views.images.shape[:2]).to(views.images)
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
        vectors = scene.semantics[name].of_objects(ids)
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
