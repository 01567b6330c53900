import torch

from instok3d.scene.contacts import find_contacts


def row(*values: float) -> torch.Tensor:
    return torch.tensor([values], dtype=torch.float32)


def test_borders_and_surfaces_by_hand():
    # Regions 0 | 1 at depth 2 without a jump, then 1 | 2 with a jump from 2 to 3.
    ids = row(0, 0, 1, 1, 1, 2, 2).long()
    found = find_contacts(ids, ids, row(2, 2, 2, 2, 2, 3, 3), 3, 3)
    assert found.border.tolist() == [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
    assert found.surface.tolist() == [[0, 1, 0], [1, 0, 0], [0, 0, 0]]


def test_a_blended_border_is_still_a_jump_and_a_slope_is_none():
    ids = row(0, 0, 0, 1, 1, 1).long()
    blended = find_contacts(ids, ids, row(2, 2, 2.4, 2.7, 3, 3), 2, 2)
    assert (blended.border[0, 1], blended.surface[0, 1]) == (1, 0)
    slope = find_contacts(ids, ids, row(2, 2.03, 2.06, 2.09, 2.12, 2.15), 2, 2)
    assert slope.surface[0, 1] == 1


def test_rows_may_be_finer_than_columns():
    # Two regions of column 0 with column 1 between them: no border between what has one column.
    rows, columns = row(0, 0, 2, 2, 1, 1, 3).long(), row(0, 0, 1, 1, 0, 0, 0).long()
    found = find_contacts(rows, columns, torch.ones(1, 7), 4, 2)
    assert found.border.tolist() == [[0, 1], [0, 1], [2, 0], [0, 0]]


def test_nothing_is_no_surface_and_tiny_pictures_have_no_contacts():
    ids = row(0, 0, 1, 1).long()
    assert find_contacts(ids, ids, torch.zeros(1, 4), 2, 2).surface.sum() == 0
    assert find_contacts(ids, ids, torch.zeros(1, 4), 2, 2).border[0, 1] == 1
    tiny = torch.tensor([[0, 1, 1], [0, 1, 1]])
    assert find_contacts(tiny, tiny, torch.ones(2, 3), 2, 2).border.sum() == 0
    empty = torch.zeros(0, 0, dtype=torch.long)
    assert find_contacts(empty, empty, torch.zeros(0, 0), 2, 2).border.shape == (2, 2)
