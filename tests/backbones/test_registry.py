from dataclasses import dataclass

import pytest

from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.backbones.registry import BACKBONES, BackboneKind, build_backbone, name_of
from plane_backbone import PlaneBackbone, PlaneConfig


@dataclass(frozen=True)
class WiderConfig(PlaneConfig):
    """Another backbone's config that happens to inherit from a known one's."""


def test_a_config_makes_its_own_backbone(monkeypatch):
    monkeypatch.setitem(BACKBONES, "plane", lambda: BackboneKind(PlaneBackbone, PlaneConfig))
    plane = build_backbone(PlaneConfig(channels=4))
    assert isinstance(plane, PlaneBackbone)
    assert plane.feature_channels == 4
    assert name_of(plane) == "plane"
    nano = build_backbone(NanoConfig(width=64, layers=1))
    assert isinstance(nano, NanoBackbone)
    assert name_of(nano) == "nano"


def test_an_unknown_config_is_named(monkeypatch):
    monkeypatch.setitem(BACKBONES, "plane", lambda: BackboneKind(PlaneBackbone, PlaneConfig))
    with pytest.raises(ValueError, match=r"made from a WiderConfig; wanted .*'nano'"):
        build_backbone(WiderConfig())


def test_an_unregistered_backbone_is_named():
    with pytest.raises(ValueError, match="PlaneBackbone is not in backbones"):
        name_of(PlaneBackbone(PlaneConfig()))


def test_every_registered_kind_is_a_backbone_with_its_dataclass():
    for name, load in BACKBONES.items():
        kind = load()
        assert name_of(object.__new__(kind.backbone)) == name
        assert kind.config.__dataclass_params__.frozen
