"""Encoders for questions: one whose space has three axes, and one in a file as the shipped one is.

The three axes are those of the features of `made_scene.made_semantics`.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.files import write_safetensors
from instok3d.rooms.classes import CLASSES
from instok3d.scene.scene import Scene
from instok3d.semantics.predictor import Predictor, PredictorConfig
from instok3d.semantics.query.calibration import Calibration
from instok3d.semantics.query.encoder import QueryEncoder
from instok3d.semantics.query.ranking import COLOR_NAMES, MATERIAL_NAMES
from instok3d.semantics.query.shipped import save_calibration
from instok3d.semantics.teachers.file import teacher_tensors
from instok3d.semantics.teachers.rooms import RoomTeacher
from instok3d.semantics.text import quantized
from instok3d.semantics.wordpiece import UNKNOWN
from made_scene import made_scene, made_tokens

AXES = {"chair": 0, "table": 1, "lamp": 2, "red": 0}
"""Axis of a word; all other words of classes lie between all of them."""


class MadeTeacher:
    """Texts by the words of AXES, pictures by their mean colour."""

    name = "made-3"
    channels = 3

    def features(
        self, images: Float[Tensor, "view 3 height width"]
    ) -> Float[Tensor, "view channel row column"]:
        """The colours themselves."""
        return images

    def text(self, texts: Sequence[str]) -> Float[Tensor, "text channel"]:
        """The axis of the last word that has one; a known word without one points away."""
        return functional.normalize(torch.stack([self._vector(text) for text in texts]), dim=1)

    def crop(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " channel"]:
        """The direction of the mean colour."""
        return functional.normalize(image.mean(dim=(1, 2)), dim=0)

    def _vector(self, text: str) -> Tensor:
        if "zebra" in text:
            raise ValueError(f"no word of {text!r} is known: describe it in English words")
        if text in AXES:
            return torch.eye(3)[AXES[text]]
        return torch.tensor([-1.0, -1.0, -1.0])


def made_encoder() -> QueryEncoder:
    """Its calibration tells the axes apart: cosine 1 is meant, 0.5 is not."""
    return QueryEncoder(MadeTeacher(), Calibration(
        class_scale=10.0, color_scale=10.0, score_weight=20.0, evidence_weight=0.0, bias=-14.0,
        threshold=0.5, label_threshold=0.5,
    ))  # fmt: skip


CHANNELS = 64
TINY = PredictorConfig(CHANNELS, 16, 1, 8, 8, 8)


def write_encoder(file: Path) -> RoomTeacher:
    """A teacher with random weights and random words, and its calibration, in one file."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        predictor = Predictor(TINY)
    words = sorted({word for name in (*CLASSES, *COLOR_NAMES, *MATERIAL_NAMES, "throne")
                    for word in name.split()})  # fmt: skip
    vectors = torch.randn(len(words) + 1, CHANNELS, generator=torch.Generator().manual_seed(0))
    teacher = RoomTeacher(predictor, quantized(vectors, [UNKNOWN, *words], "made up"))
    tensors, metadata = teacher_tensors(teacher)
    calibration = Calibration(
        class_scale=20.0, color_scale=20.0, score_weight=20.0, evidence_weight=0.0, bias=-14.0,
        threshold=0.5, label_threshold=0.5,
    )  # fmt: skip
    write_safetensors(file, tensors, {**metadata, **save_calibration(calibration)})
    return teacher


def made_room(teacher: RoomTeacher) -> Scene:
    """A scene that this teacher saw: object 1 is a red chair, object 3 a white lamp."""
    scene = made_scene(made_tokens())
    known = scene.semantics["made-3"]
    said = teacher.text(["chair", "wall", "lamp", "wall"]) + teacher.text(
        ["red", "white", "white", "white"]
    ).mul(0.5)  # fmt: skip
    basis = known.shared.shape[1]
    shared = said[:, None].expand(-1, basis, -1).half().float()
    residual_map = torch.zeros(CHANNELS, known.residuals.shape[1])
    own = replace(known, shared=shared.contiguous(), residual_map=residual_map)
    return replace(scene, semantics={teacher.name: own})
