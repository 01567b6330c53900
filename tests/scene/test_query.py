"""Questions to a scene with semantics of three axes: chair, table, lamp (`made_encoder`)."""

from dataclasses import replace

import pytest
import torch

from instok3d.scene.query import SceneQueries, named_objects
from instok3d.scene.scene import Scene
from instok3d.semantics.query.encoder import QueryEncoder
from made_encoder import made_encoder
from made_scene import made_empty_scene, made_scene, made_tokens


@pytest.fixture
def room() -> Scene:
    """Objects 1, on the axis of chairs, and 3, on that of lamps."""
    return made_scene(made_tokens())


@pytest.fixture
def encoder() -> QueryEncoder:
    return made_encoder()


def test_the_object_that_is_meant_comes_alone(room: Scene, encoder: QueryEncoder):
    answers = room.query("chair", encoder=encoder)
    assert [answer.object.key for answer in answers] == ["object#1"]
    assert answers.present
    assert answers[0].probability > 0.9
    assert answers[0].score == pytest.approx(1, abs=0.1)
    assert answers.understood == "one object like 'chair'"
    assert [answer.object.id for answer in answers.ranked] == [1, 3]
    picture = answers[0].thumbnail()
    assert picture.shape == (room.height, room.width, 3)
    assert (picture < 250).any()


def test_what_is_not_there_is_said_to_be_absent(room: Scene, encoder: QueryEncoder):
    answers = room.query("table", encoder=encoder)
    assert not answers.present
    assert len(answers) == 0
    assert answers.words().startswith("not present (closest: object#")


def test_several_are_all_that_pass_and_one_question_gives_k(room: Scene, encoder: QueryEncoder):
    both = room.duplicate(1, (0.3, 0, 0))
    assert [each.object.id for each in both.query("all chairs", encoder=encoder)] == [1, 5]
    assert [each.object.id for each in both.query("chair", encoder=encoder)] == [1, 5]
    assert len(both.query("chair", k=1, encoder=encoder)) == 1
    assert len(both.query("two chairs", k=1, encoder=encoder)) == 2
    right = both.query("the chair nearest to the lamp", encoder=encoder)
    distance = [
        torch.dist(torch.tensor(both.object(i).centroid), torch.tensor(both.object(3).centroid))
        for i in (1, 5)
    ]
    assert right.ranked[0].object.id == (1 if distance[0] < distance[1] else 5)


def test_edits_are_in_the_answers(room: Scene, encoder: QueryEncoder):
    assert not room.remove(1).query("chair", encoder=encoder).present
    assert not room.hide(1).query("chair", encoder=encoder).present
    renamed = room.rename(3, "zebra")
    assert [each.object.id for each in renamed.query("zebra", encoder=encoder)] == [3]
    assert renamed.query("zebra", encoder=encoder)[0].score is None
    assert room.remove(1).undo().query("chair", encoder=encoder).present


def test_a_picture_is_an_answer_too(room: Scene, encoder: QueryEncoder):
    blue = torch.zeros(3, 8, 8)
    blue[2] = 0.5  # the third axis: lamps
    answers = room.query(image=blue, encoder=encoder)
    assert [each.object.id for each in answers] == [3]
    assert answers.understood == "one object like the picture"


def test_heat_maps_are_high_where_the_object_is_seen(room: Scene, encoder: QueryEncoder):
    queries = SceneQueries(room, encoder)
    maps = queries.heat_maps(queries.wanted_vector("the chair on the table"))
    assert maps.shape == (len(room.views), room.height, room.width)
    assert ((maps >= 0) & (maps <= 1)).all()
    ids = room.render(ids=True).ids
    assert ids is not None
    assert float(maps[ids == 1].mean()) > 2 * float(maps[ids == 3].mean())
    assert queries.heat_maps(queries.wanted_vector("chair"), [0]).shape[0] == 1
    with pytest.raises(ValueError, match="names no kind of thing"):
        queries.wanted_vector("the largest object")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"text": ""}, "the question is empty"),
        ({"text": "zebra"}, "no word of 'zebra' is known"),
        ({"text": "chair left of the table"}, "'left' depends"),
        ({}, "one of the two"),
        ({"text": "chair", "image": torch.zeros(3, 4, 4)}, "one of the two"),
        ({"text": "chair", "k": 0}, "k must be at least 1, got 0"),
    ],
)
def test_questions_that_cannot_be_answered_are_refused(
    room: Scene, encoder: QueryEncoder, arguments: dict, reason: str
):
    with pytest.raises(ValueError, match=reason):
        room.query(**arguments, encoder=encoder)


def test_a_scene_without_semantics_says_so(room: Scene, encoder: QueryEncoder):
    scene = replace(room, semantics={})
    with pytest.raises(ValueError, match="this scene has no semantics: "):
        scene.query("chair", encoder=encoder)
    with pytest.raises(ValueError, match="this scene has no semantics: "):
        scene.query("chair")
    other = replace(room, semantics={"other-1": room.semantics["made-3"]})
    with pytest.raises(ValueError, match="no semantics of 'made-3', but of other-1"):
        other.query("chair", encoder=encoder)


def test_a_scene_without_objects_answers_that_nothing_is_there(encoder: QueryEncoder):
    empty = made_empty_scene()
    answers = empty.query("chair", encoder=encoder)
    assert (answers.words(), answers.ranked) == ("not present", ())


def test_objects_are_named_in_words_where_no_name_is_meant(room: Scene, encoder: QueryEncoder):
    def ids(text: str, scene: Scene = room) -> list[int]:
        return [item.id for item in named_objects(scene, text, encoder)]

    assert ids("1") == [1]
    assert ids("object#3") == [3]
    assert ids("the chair") == [1]
    both = room.duplicate(1, (0.3, 0, 0))
    assert ids("all chairs", both) == [1, 5]
    with pytest.raises(KeyError, match=r"'chair' may mean object#1 \d+%, object#5 \d+%: name one"):
        ids("chair", both)
    with pytest.raises(KeyError, match=r"'table' is not present in this scene \(closest: object#"):
        ids("table")
    with pytest.raises(KeyError, match="no object 7"):
        ids("7")
    with pytest.raises(ValueError, match="'left' depends"):
        ids("chair left of the lamp")
    with pytest.raises(KeyError, match="no object 'the chair'"):
        named_objects(room, "the chair")


def test_a_label_of_two_objects_is_no_question(room: Scene, encoder: QueryEncoder):
    same = room.rename(1, "chair").rename(3, "chair")
    with pytest.raises(KeyError, match="2 objects have the label 'chair'; name one of"):
        named_objects(same, "chair", encoder)
