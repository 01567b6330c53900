"""The methods by their names."""

from collections.abc import Callable
from typing import Literal

from instok3d.baselines.identity import GaussianGrouping
from instok3d.baselines.lifting import LabelLifting
from instok3d.baselines.object_labels import ObjectGs
from instok3d.baselines.settings import SplatSettings
from instok3d.baselines.splats import SplatMethod
from instok3d.evaluation.methods import Method

MethodName = Literal["3dgs", "gaussian-grouping", "objectgs", "label-lifting"]

METHODS: dict[MethodName, Callable[[SplatSettings], Method]] = {
    "3dgs": SplatMethod,
    "gaussian-grouping": GaussianGrouping,
    "objectgs": ObjectGs,
    "label-lifting": LabelLifting,
}
"""All of them optimise each scene."""
