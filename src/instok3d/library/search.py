"""Exact search: the cosine of a query and every row, in blocks that stay in the cache."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float

from instok3d.library.native_search import kernel

BLOCK = 1024
"""Rows turned to float32 together."""


@dataclass(frozen=True)
class Found:
    """The best rows of some, best first; equal ones in the order of their rows."""

    rows: np.ndarray
    scores: np.ndarray


def nearest(
    embeddings: np.ndarray,
    query: Float[np.ndarray, " channel"],
    count: int,
    left_out: Bool[np.ndarray, " row"] | None = None,
) -> Found:
    """The rows with the largest dot products, all of them looked at.

    Args:
        embeddings: [row, channel] in float16, in memory or mapped.
        query: Of unit length, as the rows are.
        count: How many are wanted; there may be fewer.
        left_out: Rows that do not count.
    """
    scores = dot_products(embeddings, query)
    if left_out is not None:
        scores[left_out] = -np.inf
    wanted = min(count, len(scores) if left_out is None else int((~left_out).sum()))
    if wanted <= 0:
        return Found(np.zeros(0, np.int64), np.zeros(0))
    least = np.partition(scores, len(scores) - wanted)[len(scores) - wanted]
    # What rounding may have put below the last one is looked at as well, in double precision.
    margin = len(query) * np.finfo(np.float32).eps
    rows = np.flatnonzero(scores >= least - 2 * margin)
    exact = _exact(embeddings, query, rows)
    order = np.argsort(-exact, kind="stable")[:wanted]
    return Found(rows[order], exact[order])


def _exact(embeddings: np.ndarray, query: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Dot products of some rows in double precision; a row's does not depend on the others."""
    wide = query.astype(np.float64)
    parts = [
        (embeddings[rows[place : place + BLOCK]].astype(np.float64) * wide).sum(axis=1)
        for place in range(0, len(rows), BLOCK)
    ]
    return np.concatenate(parts)


def dot_products(
    embeddings: np.ndarray, query: Float[np.ndarray, " channel"]
) -> Float[np.ndarray, " row"]:
    """The dot product of each row with the query, added up in float32.

    By the C++ kernel where it was built, which reads the rows as fast as memory gives them.
    """
    vector, scores = np.ascontiguousarray(query, np.float32), np.empty(len(embeddings), np.float32)
    if kernel is None:
        return in_blocks(embeddings, vector, scores)
    rows = np.ascontiguousarray(embeddings).view(np.uint16)
    kernel.dot_products(rows, vector, scores, threads=torch.get_num_threads())
    return scores


def in_blocks(
    embeddings: np.ndarray, query: Float[np.ndarray, " channel"], scores: Float[np.ndarray, " row"]
) -> Float[np.ndarray, " row"]:
    """What the kernel does, in PyTorch: blocks are turned to float32 in the processor's cache.

    Args:
        embeddings: As of `nearest`.
        query: In float32.
        scores: Where the result goes.
    """
    rows, vector = torch.from_numpy(_writable_view(embeddings)), torch.from_numpy(query)
    block, result = torch.empty(BLOCK, len(query)), torch.from_numpy(scores)
    for place in range(0, len(rows), BLOCK):
        part = rows[place : place + BLOCK]
        values = block[: len(part)].copy_(part)
        torch.mv(values, vector, out=result[place : place + len(part)])
    return scores


def _writable_view(array: np.ndarray) -> np.ndarray:
    """The same memory for torch, which warns of arrays that must not be written; nothing writes."""
    if array.flags.writeable or not len(array):
        return np.asarray(array)
    address = array.__array_interface__ | {"data": (array.ctypes.data, False)}
    holder = type("Holder", (), {"__array_interface__": address, "keep": array})()
    return np.asarray(holder)
