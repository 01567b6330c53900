from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from instok3d.backbones import BackboneConfig, BackboneKind, build_backbone, register_backbone
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.backbones.registry import (
    OWN,
    backbone_names,
    config_named,
    kind_named,
    kind_of,
    name_of,
)
from plane_backbone import PLANE, PlaneBackbone, PlaneConfig


@dataclass(frozen=True)
class WiderConfig(PlaneConfig):
    """Another backbone's config that happens to inherit from a known one's."""


def test_a_config_makes_its_own_backbone(plane):
    made = build_backbone(PlaneConfig(channels=4))
    assert isinstance(made, PlaneBackbone)
    assert made.feature_channels == 4
    assert name_of(made) == plane == "plane"
    assert kind_named("plane") is kind_of(PlaneConfig()) is PLANE
    assert config_named("PlaneConfig") is PlaneConfig
    assert backbone_names() == sorted([*OWN, "plane"])
    nano = build_backbone(NanoConfig(width=64, layers=1))
    assert isinstance(nano, NanoBackbone)
    assert name_of(nano) == "nano"


def test_an_unknown_config_is_named(plane):
    with pytest.raises(ValueError, match=r"made from a WiderConfig: register it .* nano, plane"):
        build_backbone(WiderConfig())
    with pytest.raises(ValueError, match="no backbone is made from a WiderConfig"):
        config_named("WiderConfig")
    with pytest.raises(ValueError, match=r"no backbone is called 'wider'; there are .*nano"):
        kind_named("wider")


def test_an_unregistered_backbone_is_named():
    with pytest.raises(ValueError, match="PlaneBackbone is not registered"):
        name_of(PlaneBackbone(PlaneConfig()))


@pytest.mark.parametrize("name", sorted(OWN))
def test_every_kind_of_the_package_is_whole(name: str):
    kind = OWN[name]()
    assert name_of(object.__new__(kind.backbone)) == name
    assert kind.config.__dataclass_params__.frozen
    assert issubclass(kind.config, BackboneConfig)
    assert kind.activations is not None


def test_registering_twice_is_no_harm_but_a_name_has_one_backbone(plane):
    register_backbone("plane", PLANE)
    with pytest.raises(ValueError, match="there is a backbone 'plane' already"):
        register_backbone("plane", replace(PLANE, added_later={"channels": 2}))
    with pytest.raises(ValueError, match="there is a backbone 'nano' already"):
        register_backbone("nano", PLANE)


def test_what_is_no_kind_is_refused():
    class Bare:
        pass

    class NoDataclass(BackboneConfig):
        pass

    @dataclass(frozen=True)
    class NanoConfig(BackboneConfig):
        pass

    for config in (Bare, NoDataclass):
        with pytest.raises(ValueError, match=f"'own' are a {config.__name__}; wanted a frozen"):
            register_backbone("own", wrong_kind(config))
    with pytest.raises(ValueError, match=r"a NanoConfig, as those of nano; .* must be another"):
        register_backbone("own", wrong_kind(NanoConfig))
    assert "own" not in backbone_names()


def wrong_kind(config: type) -> BackboneKind:
    """Past the run-time checks of the tests, which users do not have."""
    kind = object.__new__(BackboneKind)
    for name, value in {**vars(PLANE), "config": config}.items():
        object.__setattr__(kind, name, value)
    return kind


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch, **points: str) -> None:
    """A package in a folder that names these entry points."""
    metadata = folder / "flat_worlds-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: flat-worlds\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, value in points.items()]
    (metadata / "entry_points.txt").write_text("\n".join(["[instok3d.backbones]", *lines, ""]))
    monkeypatch.syspath_prepend(folder)


def test_an_installed_package_brings_a_backbone(tmp_path, monkeypatch):
    installed(tmp_path, monkeypatch, flat="plane_backbone:PLANE")
    assert "flat" in backbone_names()
    made = build_backbone(PlaneConfig(channels=4))
    assert name_of(made) == "flat"
    assert config_named("PlaneConfig") is PlaneConfig


def test_a_package_that_cannot_be_imported_is_named_and_harms_no_other(tmp_path, monkeypatch):
    installed(
        tmp_path, monkeypatch, broken="no_such_module:KIND", flat="plane_backbone:PLANE",
        empty="plane_backbone:nothing", other="plane_backbone:PlaneConfig",
    )  # fmt: skip
    with pytest.raises(ValueError, match="'broken' is no_such_module:KIND of the package flat-w"):
        kind_named("broken")
    with pytest.raises(ValueError, match=r"'empty' .* cannot be imported"):
        kind_named("empty")
    with pytest.raises(ValueError, match="'other' is a type, wanted a BackboneKind"):
        kind_named("other")
    assert isinstance(build_backbone(NanoConfig(width=64, layers=1)), NanoBackbone)
    with pytest.warns(UserWarning, match="broken"):
        assert isinstance(build_backbone(PlaneConfig()), PlaneBackbone)


def test_a_package_cannot_take_the_place_of_a_backbone(tmp_path, monkeypatch):
    installed(tmp_path, monkeypatch, nano="plane_backbone:PLANE")
    with pytest.warns(UserWarning, match="'nano' of the package flat-worlds is left out"):
        assert "plane" not in backbone_names()
    assert kind_named("nano").backbone is NanoBackbone
