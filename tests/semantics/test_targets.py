import pytest
import torch
from torch.nn import functional

from instok3d.data.words import ObjectWords
from instok3d.semantics.targets import target_map, target_vectors
from instok3d.semantics.text import TextTable, quantized
from instok3d.semantics.wordpiece import UNKNOWN


@pytest.fixture
def table() -> TextTable:
    """Three words that stand at right angles."""
    return quantized(torch.eye(4), (UNKNOWN, "sofa", "red", "fabric"), "made up")


def test_a_target_is_class_and_half_its_colour_and_a_quarter_of_its_material(table: TextTable):
    found = target_vectors({5: ObjectWords("sofa", "red", "fabric")}, table)
    wanted = functional.normalize(torch.tensor([0, 1, 0.5, 0.25]), dim=0)
    torch.testing.assert_close(found[5], wanted)


def test_unknown_words_have_no_part(table: TextTable):
    found = target_vectors({5: ObjectWords("sofa"), 6: ObjectWords("")}, table)
    assert found.keys() == {5}
    torch.testing.assert_close(found[5], torch.tensor([0.0, 1, 0, 0]))


def test_pixels_have_the_vector_of_their_instance_and_ignored_ones_have_none(table: TextTable):
    words = {1: ObjectWords("sofa"), 2: ObjectWords("red")}
    vectors, known = target_map(torch.tensor([[[-1, 0, 1], [2, 3, 1]]]), words, table)
    assert known.tolist() == [[[False, False, True], [True, False, True]]]
    assert vectors.shape == (1, 4, 2, 3)
    torch.testing.assert_close(vectors[0, :, 0, 2], torch.tensor([0.0, 1, 0, 0]))
    torch.testing.assert_close(vectors[0, :, 1, 0], torch.tensor([0.0, 0, 1, 0]))
    assert not vectors[0, :, 0, :2].any()


def test_a_scene_without_words_and_a_map_without_pixels_have_no_targets(table: TextTable):
    assert target_vectors({}, table) == {}
    vectors, known = target_map(torch.zeros(0, 4, 4, dtype=torch.int64), {}, table)
    assert vectors.shape == (0, 4, 4, 4)
    assert known.shape == (0, 4, 4)
    assert not target_map(torch.ones(1, 4, 4, dtype=torch.int64), {}, table)[1].any()
