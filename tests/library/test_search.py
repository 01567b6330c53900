import numpy as np
import pytest

from instok3d.library.native_search import kernel
from instok3d.library.search import dot_products, in_blocks, nearest


def unit(rng: np.random.Generator, rows: int, channels: int) -> np.ndarray:
    values = rng.standard_normal((rows, channels))
    return (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float16)


def test_two_rows_by_hand():
    # (1, 0) . (.6, .8) = .6; (0, 1) . (.6, .8) = .8
    rows = np.eye(2, dtype=np.float16)
    found = nearest(rows, np.array([0.6, 0.8], np.float32), 2)
    assert found.rows.tolist() == [1, 0]
    np.testing.assert_allclose(found.scores, [0.8, 0.6], atol=1e-7)


@pytest.mark.parametrize(("rows", "channels"), [(1, 1), (1023, 7), (1024, 16), (5000, 37)])
def test_the_twin_in_double_precision(rows: int, channels: int):
    rng = np.random.default_rng(rows)
    values, query = unit(rng, rows, channels), unit(rng, 1, channels)[0].astype(np.float32)
    wanted = values.astype(np.float64) @ query.astype(np.float64)
    np.testing.assert_allclose(dot_products(values, query), wanted, atol=1e-6)
    found = nearest(values, query, 10)
    assert found.rows.tolist() == np.argsort(-wanted, kind="stable")[:10].tolist()
    np.testing.assert_allclose(found.scores, wanted[found.rows], atol=1e-12)


def test_every_kernel_and_pytorch_give_the_same():
    if kernel is None:
        pytest.skip("the kernel was not built with instok3d")
    # All magnitudes of float16, the smallest below the normal ones; sizes beside whole vectors.
    rng = np.random.default_rng(4)
    for channels in (1, 31, 64, 100, 384):
        bits = rng.integers(0, 1 << 16, (77, channels), dtype=np.uint16)
        values = bits.view(np.float16)
        values[~np.isfinite(values)] = 1
        query = rng.standard_normal(channels).astype(np.float32)
        wanted = values.astype(np.float64) @ query.astype(np.float64)
        scale = np.abs(values).astype(np.float64) @ np.abs(query)
        slow = in_blocks(values, query, np.empty(77, np.float32))
        assert (np.abs(slow - wanted) <= 1e-6 * channels * scale + 1e-12).all()
        for name in kernel.kernels():
            for threads in (1, 2):
                found = np.full(77, np.nan, np.float32)
                kernel.dot_products(
                    values.view(np.uint16), query, found, threads=threads, kernel=name
                )
                assert (np.abs(found - wanted) <= 1e-6 * channels * scale + 1e-12).all(), name


def test_the_kernel_takes_no_other_shapes():
    if kernel is None:
        pytest.skip("the kernel was not built with instok3d")
    rows = np.zeros((3, 4), np.uint16)
    for query, scores in ((5, 3), (4, 2)):
        with pytest.raises(ValueError, match="has the shape"):
            kernel.dot_products(
                rows, np.zeros(query, np.float32), np.zeros(scores, np.float32), threads=1
            )
    with pytest.raises(ValueError, match="no kernel other on this processor"):
        kernel.dot_products(
            rows, np.zeros(4, np.float32), np.zeros(3, np.float32), threads=1, kernel="other"
        )


def test_rows_that_rounding_cannot_tell_apart_are_in_order():
    # The same row a thousand times among others, at places where sums are done differently.
    rng = np.random.default_rng(2)
    values = unit(rng, 3000, 19)
    values[::3] = values[0]
    query = values[0].astype(np.float32)
    assert nearest(values, query, 5).rows.tolist() == [0, 3, 6, 9, 12]


def test_rows_left_out_are_not_found():
    rng = np.random.default_rng(3)
    values, query = unit(rng, 50, 8), unit(rng, 1, 8)[0].astype(np.float32)
    best = nearest(values, query, 3).rows
    left_out = np.zeros(50, bool)
    left_out[best[:2]] = True
    assert nearest(values, query, 1, left_out).rows.tolist() == [best[2]]
    assert len(nearest(values, query, 50, left_out).rows) == 48
    assert len(nearest(values, query, 5, np.ones(50, bool)).rows) == 0


def test_nothing_is_found_in_nothing():
    assert len(nearest(np.zeros((0, 4), np.float16), np.ones(4, np.float32), 3).rows) == 0
