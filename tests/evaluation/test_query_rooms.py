"""What answers questions about a room: true words, a teacher on masks, objects of a scene."""

import pytest
import torch

from instok3d.data.words import ObjectWords
from instok3d.evaluation.queries import Thing
from instok3d.evaluation.query_rooms import (
    RoomTruth,
    by_scene,
    by_teacher,
    by_words,
    mask_vectors,
)
from instok3d.semantics.text import quantized
from instok3d.semantics.wordpiece import UNKNOWN
from made_encoder import MadeTeacher
from made_scene import HEIGHT, WIDTH, made_scene, made_tokens

TABLE = quantized(torch.eye(4), (UNKNOWN, "chair", "lamp", "red"), "made up")


@pytest.fixture
def truth() -> RoomTruth:
    """A red chair (id 7) in the left third of both views, a lamp (id 9) in the right third."""
    instances = torch.zeros(2, HEIGHT, WIDTH, dtype=torch.long)
    instances[..., : WIDTH // 3] = 7
    instances[..., -WIDTH // 3 :] = 9
    images = torch.zeros(2, 3, HEIGHT, WIDTH)
    images[:, 0, :, : WIDTH // 3] = 1
    images[:, 2, :, -WIDTH // 3 :] = 0.5
    things = tuple(
        Thing(words, (x, 0.0, 0.0), (x + 1, 1.0, 1.0), -1)
        for x, words in ((0.0, ObjectWords("chair", "red")), (5.0, ObjectWords("lamp")))
    )
    return RoomTruth(things, (7, 9), instances, images, ())


def test_true_words_are_weighed_as_the_teachers_targets(truth: RoomTruth):
    found = by_words(truth, TABLE)
    assert found.thing_of == (0, 1)
    # Class 1 and colour 1/2, normalised; a lamp alone.
    root = 1.25**0.5
    expected = [[0, 1 / root, 0, 0.5 / root], [0, 0, 1, 0]]
    torch.testing.assert_close(found.candidates.vectors, torch.tensor(expected))
    assert found.candidates.boxes.low[:, 0].tolist() == [0, 5]


def test_a_teacher_is_averaged_over_each_mask(truth: RoomTruth):
    found = by_teacher(truth, MadeTeacher())
    torch.testing.assert_close(found.candidates.vectors, torch.eye(3)[[0, 2]])
    empty = mask_vectors(truth.images, truth.instances, [8], MadeTeacher())
    assert empty.tolist() == [[0, 0, 0]]


def test_objects_of_a_scene_show_what_has_most_of_their_pixels(truth: RoomTruth):
    # The red blob, object 1, is left of the middle, the blue one, object 3, right of it.
    scene = made_scene(made_tokens())
    asked = []

    def vectors(scene, things):
        asked.append(things)
        return torch.eye(3)[[0, 2]]

    found = by_scene(truth, scene, vectors)
    assert found.thing_of == (0, 1) == asked[0]
    assert found.candidates.boxes.low.shape == (2, 3)


def test_a_room_without_things_has_no_candidates():
    bare = RoomTruth((), (), torch.zeros(1, 4, 4, dtype=torch.long), torch.zeros(1, 3, 4, 4), ())
    assert by_words(bare, TABLE).candidates.vectors.shape == (0, 4)
    assert by_teacher(bare, MadeTeacher()).thing_of == ()
