import torch

from instok3d.scene.edits.texture import continued, smoothly_filled


def hole(rows: int, columns: int) -> torch.Tensor:
    known = torch.ones(rows, columns, dtype=torch.bool)
    known[rows // 3 : rows // 2, columns // 3 : columns // 2] = False
    return known


def test_a_slope_is_continued_exactly():
    y, x = torch.meshgrid(torch.arange(24.0), torch.arange(31.0), indexing="ij")
    values = torch.stack([0.1 * x + 0.02 * y, 1 - 0.03 * y])
    known = hole(24, 31)
    filled = smoothly_filled(torch.where(known, values, 9.0), known)
    assert torch.equal(filled[:, known], values[:, known])
    torch.testing.assert_close(filled, values, atol=2e-3, rtol=0)


def test_a_pattern_that_repeats_is_continued():
    y, x = torch.meshgrid(torch.arange(40), torch.arange(50), indexing="ij")
    board = ((x // 4 + y // 4) % 2).float()
    values = torch.stack([0.2 + 0.5 * board, 0.5 * board, board]) + 0.005 * x
    known = hole(40, 50)
    filled = continued(torch.where(known, values, 0.0), known, ~known)
    torch.testing.assert_close(filled, values, atol=0.03, rtol=0)
    smooth = smoothly_filled(torch.where(known, values, 0.0), known)
    assert (smooth - values).abs().mean() > 10 * (filled - values).abs().mean()


def test_noise_repeats_nothing_and_is_continued_smoothly():
    values = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(0))
    known = hole(40, 50)
    assert torch.equal(continued(values, known, ~known), smoothly_filled(values, known))


def test_all_known_and_nothing_known_stay():
    values = torch.rand(3, 5, 7, generator=torch.Generator().manual_seed(0))
    all_, none = torch.ones(5, 7, dtype=torch.bool), torch.zeros(5, 7, dtype=torch.bool)
    assert torch.equal(smoothly_filled(values, all_), values)
    assert torch.equal(smoothly_filled(values, none), values)
    assert torch.equal(continued(values, all_, none), values)


def test_one_known_cell_is_everywhere():
    values, known = torch.zeros(1, 6, 9), torch.zeros(6, 9, dtype=torch.bool)
    values[0, 2, 3], known[2, 3] = 0.7, True
    torch.testing.assert_close(smoothly_filled(values, known), torch.full((1, 6, 9), 0.7))
