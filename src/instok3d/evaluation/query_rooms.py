"""Rooms with known truth as candidates for questions: by true words, by a teacher, by a scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.data.words import ObjectWords
from instok3d.evaluation.queries import RoomQuestion, Thing, boxes_of, room_questions
from instok3d.rooms.dataset import RoomDataset
from instok3d.scene.query import SceneQueries
from instok3d.scene.scene import Scene
from instok3d.semantics.query.encoder import QueryEncoder
from instok3d.semantics.query.ranking import Candidates
from instok3d.semantics.targets import target_vectors
from instok3d.semantics.teacher import Teacher
from instok3d.semantics.text import TextTable

MIN_PIXELS = 64
"""In all context views together: what shows less of itself is not asked for."""


@dataclass(frozen=True)
class RoomTruth:
    """What a room shows in its context views."""

    things: tuple[Thing, ...]
    ids: tuple[int, ...]
    """Of the things, in the id maps."""
    instances: Int[Tensor, "view height width"]
    images: Float[Tensor, "view 3 height width"]
    questions: tuple[RoomQuestion, ...]


def room_truth(rooms: RoomDataset, number: int, frames: Sequence[int]) -> RoomTruth:
    """A room as it is seen from some of its frames.

    Args:
        rooms: A folder of rooms with words.
        number: Of the room.
        frames: The context views.
    """
    seen, meta = rooms.frames(number, list(frames)), rooms.meta_of(number)
    counts = {each["id"]: int((seen.instances == each["id"]).sum()) for each in meta["instances"]}
    kept = [each for each in meta["instances"] if counts[each["id"]] >= MIN_PIXELS]
    row_of = {each["id"]: row for row, each in enumerate(kept)}
    things = []
    for each in kept:
        low, high = (tuple(map(float, end)) for end in each["aabb_m"])
        words = seen.words.get(each["id"], ObjectWords(""))
        things.append(Thing(words, low, high, row_of.get(each["parent"], -1)))
    return RoomTruth(
        tuple(things), tuple(row_of), seen.instances, seen.images.permute(0, 3, 1, 2).float() / 255,
        tuple(room_questions(things, rooms.seed_of(number))),
    )  # fmt: skip


def by_words(truth: RoomTruth, table: TextTable) -> Candidates:
    """The ceiling of texts and grammar: true words, true masks, true boxes."""
    words = {row: thing.words for row, thing in enumerate(truth.things)}
    vectors = target_vectors(words, table)
    unknown = torch.zeros(table.rows.shape[1])
    stacked = [vectors.get(row, unknown) for row in range(len(truth.things))]
    return _candidates(truth, torch.stack(stacked) if stacked else torch.zeros(0, len(unknown)))


def by_teacher(truth: RoomTruth, teacher: Teacher) -> Candidates:
    """The ceiling of the grouping: a teacher's features, averaged over true masks; true boxes."""
    features = functional.interpolate(
        teacher.features(truth.images), truth.instances.shape[-2:], mode="bilinear"
    )
    directions = functional.normalize(features, dim=1).movedim(1, -1)
    vectors = [directions[truth.instances == number].mean(dim=0) for number in truth.ids]
    channels = directions.shape[-1]
    stacked = torch.stack(vectors) if vectors else torch.zeros(0, channels)
    return _candidates(truth, functional.normalize(stacked, dim=1))


def _candidates(truth: RoomTruth, vectors: Float[Tensor, "thing channel"]) -> Candidates:
    return Candidates(vectors, boxes_of(truth.things), (None,) * len(truth.things))


def by_scene(
    truth: RoomTruth, scene: Scene, encoder: QueryEncoder
) -> tuple[Candidates, tuple[int, ...]]:
    """A reconstructed scene of the context views, and the thing that each of its objects shows.

    An object shows the thing that has most of the pixels that it wins in the views; -1 for none.
    """
    ids = scene.render(ids=True).ids
    assert ids is not None
    candidates = SceneQueries(scene, encoder).candidates()
    row_of = {number: row for row, number in enumerate(truth.ids)}
    things = []
    for item in scene.objects:
        shown = truth.instances[ids == item.id]
        values, counts = shown[shown > 0].unique(return_counts=True)
        most = int(values[counts.argmax()]) if len(values) else 0
        things.append(row_of.get(most, -1))
    return candidates, tuple(things)
