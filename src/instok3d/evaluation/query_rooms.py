"""Rooms with known truth as candidates for questions: by true words, by a teacher, by a scene."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.data.words import ObjectWords
from instok3d.evaluation.queries import RoomQuestion, Thing, boxes_of, room_questions
from instok3d.model.tokenizer import Tokenizer
from instok3d.photos.pixel_map import fit_pixels
from instok3d.rooms.dataset import RoomDataset
from instok3d.scene.from_tokens import bare_scene, with_objects
from instok3d.scene.lifting import Lifting
from instok3d.scene.reconstruct import cleaned_scene
from instok3d.scene.record import Provenance, SceneView
from instok3d.scene.scene import Scene
from instok3d.scene.seen_colors import seen_color_shares
from instok3d.scene.upright_boxes import upright_boxes
from instok3d.semantics.query.ranking import Candidates
from instok3d.semantics.targets import target_vectors
from instok3d.semantics.teacher import Teacher
from instok3d.semantics.text import TextTable
from instok3d.types import Views

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


@dataclass(frozen=True)
class RoomAnswers:
    """Objects that may be answers, and what they show."""

    candidates: Candidates
    thing_of: tuple[int, ...]
    """The thing that each object shows; -1 for none."""


def by_words(truth: RoomTruth, table: TextTable) -> RoomAnswers:
    """The ceiling of texts and grammar: true words, true masks, true boxes."""
    return _of_things(truth, word_vectors(truth, table))


def word_vectors(truth: RoomTruth, table: TextTable) -> Float[Tensor, "thing channel"]:
    """What a perfect teacher says of each thing; zeros of one without words."""
    words = {row: thing.words for row, thing in enumerate(truth.things)}
    vectors = target_vectors(words, table)
    found = torch.zeros(len(truth.things), table.rows.shape[1])
    for row, vector in vectors.items():
        found[row] = vector
    return found


def by_teacher(truth: RoomTruth, teacher: Teacher) -> RoomAnswers:
    """The ceiling of the grouping: a teacher's features, averaged over true masks; true boxes."""
    return _of_things(truth, mask_vectors(truth.images, truth.instances, truth.ids, teacher))


def mask_vectors(
    images: Float[Tensor, "view 3 height width"],
    ids: Int[Tensor, "view height width"],
    wanted: Sequence[int],
    teacher: Teacher,
) -> Float[Tensor, "object channel"]:
    """The mean direction of a teacher's features over each mask; zeros of an empty one."""
    features = functional.interpolate(teacher.features(images), ids.shape[-2:], mode="bilinear")
    directions = functional.normalize(features, dim=1).movedim(1, -1)
    found = torch.zeros(len(wanted), directions.shape[-1])
    for row, number in enumerate(wanted):
        mask = ids == number
        if mask.any():
            found[row] = directions[mask].mean(dim=0)
    return functional.normalize(found, dim=1)


def _of_things(truth: RoomTruth, vectors: Float[Tensor, "thing channel"]) -> RoomAnswers:
    count = len(truth.things)
    candidates = Candidates(vectors, boxes_of(truth.things), (None,) * count)
    return RoomAnswers(candidates, tuple(range(count)))


@torch.no_grad()
def scene_of_photos(
    images: Float[Tensor, "view 3 height width"],
    tokenizer: Tokenizer,
    lifting: Lifting | None = None,
) -> Scene:
    """The scene of a model that sees bare photos, with whole objects.

    Its Gaussians are not refined; its semantics are fitted to the photos, as `reconstruct` does.

    Args:
        images: sRGB in [0, 1].
        tokenizer: In eval mode.
        lifting: Of its semantics; None leaves them out.
    """
    views = Views(images=images[None])
    features = None if lifting is None else lifting.features(views)
    lift = None
    if lifting is not None and features is not None:
        lift = lifting.of(tokenizer, views, features)
    tokens = tokenizer(views, None, lift)
    photos = (255 * images).round().to(torch.uint8).permute(0, 2, 3, 1)
    height, width = photos.shape[1:3]
    names = [
        SceneView(f"{index}.png", "0" * 64, fit_pixels(height, width, height, width))
        for index in range(len(photos))
    ]
    bare = bare_scene(tokens, photos, names, provenance=Provenance("evaluation", "", "", seed=0))
    if lifting is not None:
        bare = lifting.with_semantics(bare, tokens)
    scene = with_objects(cleaned_scene(bare))
    if lifting is None or features is None:
        return scene
    return lifting.fitted(scene, features[0])


def by_scene(
    truth: RoomTruth,
    scene: Scene,
    vectors: Callable[[Scene, tuple[int, ...]], Float[Tensor, "object channel"]],
) -> RoomAnswers:
    """The objects of a scene, by its own boxes.

    An object shows the thing that has most of the pixels that it wins in the context views.

    Args:
        truth: Of the room.
        scene: Of its context views.
        vectors: Of its objects, given what they show.
    """
    ids = scene.render(ids=True).ids
    assert ids is not None
    row_of = {number: row for row, number in enumerate(truth.ids)}
    things = []
    for item in scene.objects:
        values, counts = truth.instances[ids == item.id].unique(return_counts=True)
        most = int(values[counts.argmax()]) if len(values) else 0
        things.append(row_of.get(most, -1))
    boxes = upright_boxes(scene, scene.objects)
    found = vectors(scene, tuple(things))
    colors = seen_color_shares(scene, scene.objects)
    return RoomAnswers(Candidates(found, boxes, (None,) * len(things), colors), tuple(things))
