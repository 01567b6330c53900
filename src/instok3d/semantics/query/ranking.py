"""Which objects of a scene a question may mean, and with what probability.

Embeddings say what an object is, of what material and colour; boxes say how large it is and where.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from instok3d.semantics.query.calibration import Calibration
from instok3d.semantics.query.grammar import Description, Question, Relation
from instok3d.semantics.query.relations import ORDER_KEYS, UprightBoxes, between, relation
from instok3d.semantics.query.vocabulary import COLORS, MATERIALS

Embed = Callable[[Sequence[str]], Float[Tensor, "text channel"]]
"""Unit vectors of texts, in the space of the objects' embeddings."""


@dataclass(frozen=True)
class Vocabulary:
    """The classes that an encoder knows, by which its similarities are read."""

    names: tuple[str, ...]
    vectors: Float[Tensor, "class channel"]
    """Unit length."""
    stuff: Bool[Tensor, " class"]
    """Which are surfaces of the room, such as walls: "the largest object" means none of them."""


@dataclass(frozen=True)
class Candidates:
    """The objects of a scene, as far as questions look at them."""

    vectors: Float[Tensor, "object channel"]
    """Embeddings of unit length."""
    boxes: UprightBoxes
    named: tuple[str | None, ...]
    """The label that a person gave; None where nobody did."""
    seen_colors: Float[Tensor, "object color"] | None = None
    """Likelihood of each colour of COLOR_NAMES by what is seen of an object; None: not looked."""


COLOR_NAMES = tuple(dict.fromkeys(COLORS.values()))
MATERIAL_NAMES = tuple(dict.fromkeys(MATERIALS.values()))


def class_probabilities(
    vectors: Float[Tensor, "object channel"], vocabulary: Vocabulary, scale: float
) -> Float[Tensor, "object class"]:
    """How likely each class is for each object, if it is one of them."""
    return (scale * vectors @ vocabulary.vectors.T).softmax(dim=1)


@dataclass(frozen=True)
class Similarity:
    """How alike objects and a text or picture are, in two ways."""

    scores: Float[Tensor, " object"]
    """Cosines: they know what no class says."""
    evidence: Float[Tensor, " object"]
    """Logarithm of the probability that both are of the same class: it forgives noise, and what
    is like nothing that is known has little with any object."""


def similarity(
    vectors: Float[Tensor, "object channel"],
    wanted: Float[Tensor, " channel"],
    vocabulary: Vocabulary,
    calibration: Calibration,
) -> Similarity:
    """The similarity of objects to what is wanted.

    Args:
        vectors: Of the objects.
        wanted: Unit vector.
        vocabulary: Of the encoder.
        calibration: Its scales.
    """
    own = class_probabilities(vectors, vocabulary, calibration.class_scale)
    asked = class_probabilities(wanted[None], vocabulary, calibration.text_scale)[0]
    return Similarity(vectors @ wanted, (own @ asked).clamp_min(1e-9).log())


class Ranker:
    """Probabilities of the objects of one scene, for any question."""

    def __init__(
        self,
        candidates: Candidates,
        embed: Embed,
        vocabulary: Vocabulary,
        calibration: Calibration,
    ) -> None:
        self._candidates, self._embed = candidates, embed
        self._vocabulary, self._calibration = vocabulary, calibration

    def question(self, asked: Question) -> Float[Tensor, " object"]:
        """How likely it is that each object is meant.

        Raises:
            ValueError: The encoder knows no word of it.
        """
        return self._described(asked.thing)

    def picture(self, wanted: Float[Tensor, " channel"]) -> Float[Tensor, " object"]:
        """How likely it is that each object is what a picture shows.

        Args:
            wanted: Its unit vector, in the space of the objects' embeddings.
        """
        return self._like(wanted)

    def _described(self, thing: Description) -> Float[Tensor, " object"]:
        found = self._noun(thing.noun)
        for values, names, seen in (
            (thing.colors, COLOR_NAMES, self._candidates.seen_colors),
            (thing.materials, MATERIAL_NAMES, None),
        ):
            if values:
                found = found * self._attribute(values, names, seen)
        if thing.place is not None:
            found = self._placed(found, thing.place)
        if thing.order is not None:
            found = first_of(found, ORDER_KEYS[thing.order](self._candidates.boxes))
        return found

    def _noun(self, noun: str) -> Float[Tensor, " object"]:
        vectors = self._candidates.vectors
        if not noun:
            scale = self._calibration.class_scale
            shares = class_probabilities(vectors, self._vocabulary, scale)
            return 1 - shares[:, self._vocabulary.stuff].sum(dim=1)
        named = [label is not None and label.lower() == noun for label in self._candidates.named]
        try:
            found = self._like(self._embed([noun])[0])
        except ValueError:
            if not any(named):  # a name that a person made up is a name all the same
                raise
            found = torch.zeros(len(vectors))
        return torch.where(torch.tensor(named, dtype=torch.bool), torch.ones(()), found)

    def _like(self, wanted: Float[Tensor, " channel"]) -> Float[Tensor, " object"]:
        found = similarity(self._candidates.vectors, wanted, self._vocabulary, self._calibration)
        return self._calibration.probability(found.scores, found.evidence)

    def _attribute(
        self,
        values: Sequence[str],
        names: Sequence[str],
        seen: Float[Tensor, "object name"] | None,
    ) -> Float[Tensor, " object"]:
        """How likely each value is, against the likeliest other one of its kind.

        What is seen decides where it is known: it follows edits, which embeddings do not.
        """
        if seen is None:
            cosines = self._candidates.vectors @ self._embed(names).T
            shares = (self._calibration.color_scale * cosines).softmax(dim=1)
        else:
            shares = seen.clamp_min(1e-6)
        first, second = shares.topk(2, dim=1).values.unbind(dim=1)
        places = [names.index(value) for value in values]
        chosen = shares[:, places]
        other = torch.where(chosen == first[:, None], second[:, None], first[:, None])
        # Of several colours, "black and white", the geometric mean.
        return (chosen / (chosen + other)).clamp_min(1e-6).log().mean(dim=1).exp()

    def _placed(self, found: Float[Tensor, " object"], place: Relation) -> Float[Tensor, " object"]:
        others = [self._described(other) for other in place.others]
        boxes = self._candidates.boxes
        if not len(found):
            return found
        if place.kind == "between":
            first, second = others
            pairs = first[None, :, None] * second[None, None, :]
            return found * (between(boxes) * pairs).flatten(1).amax(dim=1)
        fits = relation(place.kind, boxes)
        if place.kind in ("nearest", "farthest"):
            # From the other thing that is most likely meant, which is none of the answers.
            other = int(others[0].argmax())
            left = found.clone()
            left[other] = 0
            return others[0][other] * first_of(left, fits[:, other])
        return found * (fits * others[0][None]).amax(dim=1)


def first_of(
    found: Float[Tensor, " object"], keys: Float[Tensor, " object"]
) -> Float[Tensor, " object"]:
    """How likely it is that each object is meant, and that none with a larger key is.

    Args:
        found: How likely it is that each is meant at all.
        keys: By which they are put in order.
    """
    order = keys.argsort(descending=True, stable=True)
    missed = torch.cat([torch.ones(1), (1 - found[order]).cumprod(0)])[:-1]
    result = torch.zeros_like(found)
    result[order] = found[order] * missed
    return result


def vocabulary_of(names: Sequence[str], stuff: Sequence[str], embed: Embed) -> Vocabulary:
    """Classes with their vectors.

    Args:
        names: Phrases that are embedded.
        stuff: Which of them are surfaces of the room.
        embed: Of the encoder.
    """
    vectors = functional.normalize(embed(list(names)), dim=1)
    return Vocabulary(tuple(names), vectors, torch.tensor([name in stuff for name in names]))
