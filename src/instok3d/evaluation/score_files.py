"""Scores of scenes as JSON, so that a long measurement goes on where it was stopped."""

from dataclasses import asdict
from typing import Any

import numpy as np

from instok3d.evaluation.instance_ap import IOU_THRESHOLDS, ImageMatches
from instok3d.evaluation.methods import Cost
from instok3d.evaluation.object_quality import ObjectScore
from instok3d.evaluation.scores import GeometryScore, SceneScore, ViewScore


def score_to_json(score: SceneScore) -> dict[str, Any]:
    """The score as JSON values; `score_from_json` gives the same score back, bit for bit."""
    return _plain(asdict(score))


def score_from_json(value: dict[str, Any]) -> SceneScore:
    """The score that `score_to_json` wrote.

    Raises:
        KeyError, TypeError, ValueError: It wrote something else.
    """
    return SceneScore(
        name=value["name"],
        level=value["level"],
        views=tuple(_view(each) for each in value["views"]),
        geometry=tuple(GeometryScore(**each) for each in value["geometry"]),
        groups_used=tuple(value["groups_used"]),
        id_agreement=tuple(value["id_agreement"]),
        objects=tuple(_objects(each) for each in value["objects"]),
        instances_3d=tuple(_matches(each) for each in value["instances_3d"]),
        costs=tuple(Cost(**each) for each in value["costs"]),
        picture_s=tuple(value["picture_s"]),
    )


def _plain(value: Any) -> Any:
    """Arrays as lists, tuples as lists."""
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


def _objects(value: dict[str, Any] | None) -> ObjectScore | None:
    if value is None:
        return None
    lists = {name: tuple(value[name]) for name in ("purities", "weights")}
    return ObjectScore(**{**value, **lists})


def _view(value: dict[str, Any]) -> ViewScore:
    masks = {name: value[name] and _matches(value[name]) for name in ("matches", "matches_large")}
    return ViewScore(**{**value, **masks})


def _matches(value: dict[str, Any]) -> ImageMatches:
    shape = (len(IOU_THRESHOLDS), len(value["scores"]))
    return ImageMatches(
        scores=np.array(value["scores"], dtype=np.float64),
        areas=np.array(value["areas"], dtype=np.int64),
        true_positive=np.array(value["true_positive"], dtype=bool).reshape(shape),
        ignored=np.array(value["ignored"], dtype=bool).reshape(shape),
        num_instances=value["num_instances"],
    )
