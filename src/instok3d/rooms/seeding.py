"""Seeds: which split a seed belongs to, and independent random streams under one seed."""

import zlib

import numpy as np

GENERATOR_VERSION = 1
"""Part of every random stream and of every shard; raised when the same seed gives another room."""

SPLIT_STARTS = {"train": 0, "val": 1_000_000, "test": 2_000_000, "transfer": 3_000_000}
"""First seed of each split; each has a million. Only transfer rooms hold the held-out content."""

SPLIT_SIZE = 1_000_000


def split_seeds(split: str) -> range:
    """All seeds of a split."""
    return range(SPLIT_STARTS[split], SPLIT_STARTS[split] + SPLIT_SIZE)


def split_of(seed: int) -> str:
    """The split that a seed belongs to: train, val, test or transfer.

    Raises:
        ValueError: The seed is outside 0 to 3,999,999.
    """
    if not 0 <= seed < len(SPLIT_STARTS) * SPLIT_SIZE:
        raise ValueError(f"seed {seed} is outside 0 to 3,999,999: no split has it")
    return list(SPLIT_STARTS)[seed // SPLIT_SIZE]


class Streams:
    """Random generators of one room, one for each purpose, independent of each other.

    A stream depends on the generator version, the seed and its own key only: drawing more
    numbers in one part of the generator leaves all other parts as they were.
    """

    def __init__(self, seed: int):
        self.seed = seed

    def child(self, *key: str | int) -> np.random.Generator:
        """The generator of one purpose; the key says which, such as "object", 3, "sofa"."""
        words = tuple(zlib.crc32(str(part).encode()) for part in key)
        sequence = np.random.SeedSequence([GENERATOR_VERSION, self.seed], spawn_key=words)
        return np.random.default_rng(sequence)
