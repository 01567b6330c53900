"""Cameras and depth from a backbone other than the model's own.

The small default model was trained to take cameras and depth as given, and its tokenizer needs the
features of its own backbone. So another network's cameras and depth are handed to the model the
way those of a depth camera are, and everything else stays as it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.backbones.base import BackboneConfig, GeometryBackbone
from instok3d.backbones.cost import Work
from instok3d.backbones.registry import name_of
from instok3d.files import sha256_of
from instok3d.geometry.cameras import resize_intrinsics
from instok3d.photos.image_decoding import decode_photo, own_pixel_limit
from instok3d.photos.loading import PhotoSet
from instok3d.scene.colmap_source import ColmapSource, check_colmap
from instok3d.scene.supplied import SuppliedGeometry, find_unsure, in_typical_lengths
from instok3d.types import Geometry, Views
from instok3d.weights import find_entry, weights_path
from instok3d.weights.cache import place_of

PUBLISHED = ("vggt-1b", "da3-base", "da3-small")
"""Backbones with published weights, named as those are; `auto` takes the first that is there."""
CHOICES = ("nano", *reversed(PUBLISHED), "colmap", "given", "auto")


@dataclass(frozen=True)
class GeometrySource:
    """A backbone that gives cameras and depth to a model with a backbone of its own."""

    name: str
    sha256: str
    """Of its weights; empty for a backbone in memory."""
    config: BackboneConfig
    load: Callable[[], GeometryBackbone]

    def work(self, views: int) -> tuple[BackboneConfig, Work] | None:
        """Its part of the job, for the forecast of memory; None for a backbone in memory."""
        if not self.sha256:
            return None
        return self.config, Work(views, self.config.image_side, self.config.image_side)


def find_source(
    geometry: str | GeometryBackbone, *, posed: bool
) -> tuple[GeometrySource | ColmapSource | None, list[str]]:
    """What `reconstruct(geometry=...)` asks for, and notes; None is the model's own backbone.

    Args:
        geometry: One of CHOICES, or a backbone.
        posed: Whether the user gives cameras.

    Raises:
        MissingWeightsError: The weights are not on this machine; says how to get them.
        ModuleNotFoundError: It is "colmap", and pycolmap is not installed.
        ValueError: It is none of CHOICES, "given" without cameras or "colmap" with cameras; or the
            weights are damaged.
    """
    if isinstance(geometry, GeometryBackbone):
        name = own_name(geometry)
        return GeometrySource(name, "", geometry.config, lambda: geometry), []
    if geometry not in CHOICES:
        raise ValueError(
            f"geometry must be one of {', '.join(CHOICES)}, or in Python a backbone, "
            f"got {geometry!r}"
        )
    if geometry == "given" and not posed:
        raise ValueError("geometry 'given' needs cameras: give them (--cameras), or take 'auto'")
    if geometry == "colmap":
        check_colmap(posed=posed)
        return ColmapSource(), []
    notes = []
    if geometry == "auto":
        geometry = "given" if posed else next(filter(_is_here, PUBLISHED), "nano")
        notes = [] if posed else [_choice_note(geometry)]
    return (None if geometry in ("nano", "given") else _published(geometry)), notes


def own_name(backbone: GeometryBackbone) -> str:
    """The name under which a backbone is registered, or that of its class."""
    try:
        return name_of(backbone)
    except ValueError:
        return type(backbone).__name__


@torch.no_grad()
def supplied_geometry(
    source: GeometrySource, photos: PhotoSet, device: str | torch.device
) -> SuppliedGeometry:
    """Runs the backbone of a source on the photos at its own size; it is gone afterwards.

    Cameras and depth that the user gave stand, and the units are theirs. Otherwise the source's
    own cameras come out, the first one as the world, with intrinsics that fit its depth (those by
    EXIF are not used), all lengths multiplied so that the median depth is TYPICAL_DEPTH.

    Args:
        source: From `find_source`.
        photos: As the model takes them.
        device: Where the backbone runs and the result lies.

    Raises:
        ValueError: Its cameras are not finite, or it is sure of no depth.
    """
    own, side = photos.views.to(device), source.config.image_side
    height, width = own.images.shape[-2:]
    # 1. The same part of the photos at the size that the source is made for.
    images = _read_images(photos, side).to(device)
    shown = Views(images) if own.cam_from_world is None else _enlarged(own, images)
    seen: Geometry = source.load().to(device).eval()(shown)
    # 2. Nearest pixels, so that no depth between two surfaces arises.
    depths = _resized(seen.depths.float(), height, width)
    confidences = _resized(seen.confidences.float(), height, width)
    # 3. Unsure depth counts as unknown, except where the user gave it.
    unsure = find_unsure(depths, confidences, seen.cameras, name=source.name)
    depths = torch.where(unsure, 0, depths)
    if own.depths is not None:
        unsure &= own.depths <= 0
        depths = torch.where(own.depths > 0, own.depths, depths)
    if own.cam_from_world is not None:
        return SuppliedGeometry(replace(own, depths=depths), unsure[0])
    # 4. Lengths as in the rooms that models are trained on.
    intrinsics = resize_intrinsics(
        seen.cameras.intrinsics.float(), scale_x=width / side, scale_y=height / side
    )
    views = Views(own.images, intrinsics, seen.cameras.cam_from_world, depths)
    return SuppliedGeometry(in_typical_lengths(views), unsure[0])


def _read_images(photos: PhotoSet, side: int) -> Float[Tensor, "1 view 3 {side} {side}"]:
    """The parts of the photos that the model sees, at another size."""
    images = []
    with own_pixel_limit():
        for path, pixel_map in zip(photos.paths, photos.pixel_maps, strict=True):
            larger = pixel_map.resized(side, side)
            images.append(
                decode_photo(path, height=side, width=side, fit=lambda _, m=larger: m).image
            )
    return torch.stack(images)[None]


def _enlarged(own: Views, images: Float[Tensor, "1 view 3 rows columns"]) -> Views:
    """Images of another size with what the user gave."""
    (height, width), (rows, columns) = own.images.shape[-2:], images.shape[-2:]
    intrinsics, depths = own.intrinsics, own.depths
    if intrinsics is not None:
        intrinsics = resize_intrinsics(intrinsics, scale_x=columns / width, scale_y=rows / height)
    if depths is not None:
        depths = _resized(depths, rows, columns)
    return Views(images, intrinsics, own.cam_from_world, depths)


def _resized(
    maps: Float[Tensor, "1 view rows columns"], height: int, width: int
) -> Float[Tensor, "1 view {height} {width}"]:
    return functional.interpolate(maps, size=(height, width), mode="nearest-exact")


def _is_here(name: str) -> bool:
    """Whether the weights are on this machine, and the package that the network needs."""
    if not place_of(find_entry(name)).is_file():
        return False
    if name.startswith("da3-"):
        from instok3d.backbones.depth_anything3 import is_installed

        return is_installed()
    return True


def _choice_note(name: str) -> str:
    if name == "nano":
        return (
            f"geometry: nano, as the weights of none of {', '.join(PUBLISHED)} can be used on this "
            "machine (see 'instok3d models pull da3-small')"
        )
    return f"geometry: {name}, the best whose weights are on this machine"


def _published(name: str) -> GeometrySource:
    path, config = weights_path(name), _config(name)
    sha256 = find_entry(name).sha256 or sha256_of(path)
    return GeometrySource(name, sha256, config, lambda: _load(config, path))


def _config(name: str) -> BackboneConfig:
    if name == "vggt-1b":
        from instok3d.backbones.vggt import VGGTConfig

        return VGGTConfig(geometry_from="depths")  # as its authors recommend for these weights
    from instok3d.backbones.depth_anything3 import DepthAnything3Config

    return DepthAnything3Config(size="small" if name == "da3-small" else "base")


def _load(config: BackboneConfig, path: Path) -> GeometryBackbone:
    from instok3d.backbones.depth_anything3 import (
        DepthAnything3Config,
        load_depth_anything3_weights,
    )
    from instok3d.backbones.vggt import VGGTConfig, load_vggt_weights

    if isinstance(config, DepthAnything3Config):
        return load_depth_anything3_weights(path, config)
    assert isinstance(config, VGGTConfig)
    return load_vggt_weights(path, config)
