"""Questions to a scene: which of its objects a text or a picture means, or that it is not there."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional

from instok3d.scene.names import USER
from instok3d.scene.objects import SceneObject, find_object
from instok3d.scene.seen_colors import seen_color_shares
from instok3d.scene.upright_boxes import upright_boxes
from instok3d.semantics.query.encoder import QueryEncoder
from instok3d.semantics.query.grammar import Description, understand
from instok3d.semantics.query.ranking import Candidates, Ranker, similarity

if TYPE_CHECKING:
    from instok3d.scene.scene import Scene

CLOSEST = 3
"""Objects that are named where none is likely enough, and candidates of an ambiguous name."""


@dataclass(frozen=True, repr=False)
class Answer:
    """An object that may be meant."""

    object: SceneObject
    score: float | None
    """Cosine with the thing's name or picture; None where any object may be meant."""
    probability: float
    """That it is meant, by the one calibration of the encoder, [0, 1]."""
    scene: "Scene" = field(compare=False)

    def __repr__(self) -> str:
        return f"<Answer {self.object.key} probability={self.probability:.2f}>"

    def thumbnail(self) -> UInt8[np.ndarray, "height width 3"]:
        """The object alone on white, as the view that shows most of it sees it, enlarged."""
        from instok3d.scene.object_pictures import object_picture  # it draws scenes: imports Scene

        return object_picture(self.scene, self.object)

    def to_json(self) -> dict[str, Any]:
        """In plain values; lengths in scene units."""
        item = self.object
        return {
            "id": item.id,
            "key": item.key,
            "label": item.label,
            "probability": self.probability,
            "score": self.score,
            "aabb": {"min": list(item.aabb.min), "max": list(item.aabb.max)},
            "obb": {"center": list(item.obb.center), "size": list(item.obb.size),
                    "quat_wxyz": list(item.obb.quat_wxyz)},
            "best_view": None if item.best_view is None else {
                "view": item.best_view.view, "box": list(item.best_view.bbox),
            },
            "thumbnail": f"previews/objects/{item.id:03d}.png",
        }  # fmt: skip


@dataclass(frozen=True, repr=False)
class Answers(Sequence[Answer]):
    """What a scene answers: the likeliest object first, or nothing where none is likely enough."""

    found: tuple[Answer, ...]
    """Those whose probability passes the threshold: k at most, or the number that was asked for."""
    ranked: tuple[Answer, ...]
    """All objects that are drawn, the likeliest first."""
    understood: str
    """How the question was read."""
    several: bool
    """Whether all that are meant were asked for, not one."""
    threshold: float
    """The calibration's."""
    encoder: str

    @property
    def present(self) -> bool:
        """Whether anything is likely enough to be what was asked for."""
        return bool(self.found)

    @overload
    def __getitem__(self, index: int) -> Answer: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Answer, ...]: ...
    def __getitem__(self, index: int | slice) -> Answer | tuple[Answer, ...]:
        return self.found[index]

    def __len__(self) -> int:
        return len(self.found)

    def __repr__(self) -> str:
        return f"<Answers {self.words()}>"

    def words(self) -> str:
        """The answer in one line."""
        if self.found:
            return ", ".join(f"{each.object.key} {each.probability:.0%}" for each in self.found)
        return f"not present{self.closest_words()}"

    def closest_words(self) -> str:
        """What comes closest, in brackets; nothing where there is no object."""
        nearest = ", ".join(
            f"{each.object.key} {each.probability:.0%}" for each in self.ranked[:CLOSEST]
        )
        return f" (closest: {nearest})" if nearest else ""


class SceneQueries:
    """Answers of one scene by one encoder; boxes and embeddings are found once."""

    def __init__(self, scene: "Scene", encoder: QueryEncoder) -> None:
        """Take the embeddings of the scene's objects.

        Raises:
            ValueError: The scene has no semantics of this encoder.
        """
        name = encoder.teacher.name
        if name not in scene.semantics:
            known = ", ".join(scene.semantics)
            raise ValueError(
                "this scene has no semantics: reconstruct it with them to search it"
                if not known
                else f"this scene has no semantics of {name!r}, but of {known}: give that encoder"
            )
        self.scene, self._encoder = scene, encoder
        # Objects that are hidden are not there for questions, as they are not in pictures.
        self._objects = tuple(item for item in scene.objects if not item.hidden)
        ids = [item.id for item in self._objects]
        self._vectors = scene.semantics[name].of_objects(ids, scene.tokens.assignment)

    def candidates(self) -> Candidates:
        """The objects that are drawn, as questions look at them."""
        named = tuple(item.label if item.label_source == USER else None for item in self._objects)
        boxes = upright_boxes(self.scene, self._objects)
        return Candidates(self._vectors, boxes, named, seen_color_shares(self.scene, self._objects))

    @cached_property
    def _ranker(self) -> Ranker:
        return Ranker(
            self.candidates(),
            self._encoder.embed,
            self._encoder.vocabulary,
            self._encoder.calibration,
        )

    def text(self, text: str, k: int = 5) -> Answers:
        """Answers to a question in words; see `Scene.query`."""
        asked = understand(text)
        probabilities = self._ranker.question(asked)
        scores = None
        if asked.thing.noun:
            scores = self._scores(asked.thing)
        wanted = asked.count if asked.count is not None else len(self._objects)
        most = wanted if asked.several else k
        return self._answers(probabilities, scores, asked.words(), asked.several, most)

    def picture(self, image: Float[Tensor, "3 height width"], k: int = 5) -> Answers:
        """Answers to a picture of one thing; see `Scene.query`."""
        wanted = self._encoder.picture(image)
        scores = self._vectors @ wanted
        understood = "one object like the picture"
        return self._answers(self._ranker.picture(wanted), scores, understood, False, k)

    def heat_maps(
        self, wanted: Float[Tensor, " channel"], views: Sequence[int] | None = None
    ) -> Float[Tensor, "view height width"]:
        """How likely each pixel of the input views shows what is wanted, [0, 1] (F of Eq. 7).

        Args:
            wanted: Unit vector of a text or a picture (`wanted_vector`).
            views: Indices of input views; None for all.
        """
        maps = self.scene.render_features(self._encoder.teacher.name, views)
        pixels = functional.normalize(maps.movedim(1, -1), dim=-1)
        calibration = self._encoder.calibration
        vocabulary = self._encoder.vocabulary
        found = torch.zeros(pixels.shape[:-1])
        for view, features in enumerate(pixels):
            flat = features.flatten(0, 1)
            alike = similarity(flat, wanted, vocabulary, calibration)
            likely = calibration.probability(alike.scores, alike.evidence) * flat.any(dim=1)
            found[view] = likely.view(features.shape[:-1])
        return found

    def wanted_vector(
        self, text: str | None = None, image: Float[Tensor, "3 height width"] | None = None
    ) -> Float[Tensor, " channel"]:
        """What is compared with pixels: the name of the thing that a text asks for, or a picture.

        Raises:
            ValueError: The text names no thing, or none that is understood.
        """
        if image is not None:
            return self._encoder.picture(image)
        noun = understand(text or "").thing.noun
        if not noun:
            raise ValueError(f"{text!r} names no kind of thing: no heat map shows it")
        return self._encoder.embed([noun])[0]

    def _scores(self, thing: Description) -> Float[Tensor, " object"] | None:
        try:
            wanted = self._encoder.embed([thing.noun])[0]
        except ValueError:  # a name that a person gave, and no word of the encoder
            return None
        return self._vectors @ wanted

    def _answers(
        self,
        probabilities: Float[Tensor, " object"],
        scores: Float[Tensor, " object"] | None,
        understood: str,
        several: bool,
        most: int,
    ) -> Answers:
        order = probabilities.argsort(descending=True, stable=True).tolist()
        ranked = tuple(
            Answer(
                self._objects[row], None if scores is None else float(scores[row]),
                float(probabilities[row]), self.scene,
            )
            for row in order
        )  # fmt: skip
        threshold = self._encoder.calibration.threshold
        found = [answer for answer in ranked if answer.probability >= threshold]
        name = self._encoder.teacher.name
        return Answers(tuple(found[:most]), ranked, understood, several, threshold, name)


def named_objects(
    scene: "Scene", text: str, encoder: QueryEncoder | None = None
) -> tuple[SceneObject, ...]:
    """The objects that a person names by id, key, label, or in words.

    Words mean one object, or several where they say so ("all chairs").

    Args:
        scene: With semantics, or words are not understood.
        text: As it was typed.
        encoder: Of the scene's semantics; None: words are not understood.

    Raises:
        KeyError: There is no such object, or the words may mean several; names the candidates.
        ValueError: The words are not understood.
    """
    try:
        return (find_object(scene.objects, int(text) if text.isdecimal() else text),)
    except KeyError:
        labelled = any(item.label == text for item in scene.objects)
        if encoder is None or labelled or "#" in text or text.isdecimal():
            raise
    answers = SceneQueries(scene, encoder).text(text, CLOSEST + 1)
    if not answers.present:
        raise KeyError(f"{text!r} is not present in this scene{answers.closest_words()}")
    if len(answers) > 1 and not answers.several:
        raise KeyError(
            f"{text!r} may mean {answers.words()}: name one by its key, or ask for all of them"
        )
    return tuple(answer.object for answer in answers)
