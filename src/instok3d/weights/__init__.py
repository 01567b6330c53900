"""Weights made elsewhere: which there are, where they lie, how they get there."""

from instok3d.weights.cache import weights_path
from instok3d.weights.catalogue import CATALOGUE, WeightsEntry, find_entries, find_entry

__all__ = [
    "CATALOGUE",
    "WeightsEntry",
    "find_entries",
    "find_entry",
    "weights_path",
]
