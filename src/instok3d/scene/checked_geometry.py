"""Geometry of photos after checks: do they overlap, and do given or solved cameras fit them?"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool
from torch import Tensor

from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.nano.backbone import ComparedPhotos, NanoBackbone
from instok3d.backbones.nano.common_points import (
    CommonPoints,
    contrast_share,
    find_common_points,
)
from instok3d.photos.loading import PhotoSet
from instok3d.scene.camera_check import camera_notes, fit_share
from instok3d.scene.colmap_source import ColmapSource, colmap_geometry
from instok3d.scene.geometry_source import GeometrySource, own_name, supplied_geometry
from instok3d.scene.odd_views import choose_confirmed_views, choose_matching_views
from instok3d.scene.stated_focal import by_best_focal
from instok3d.scene.supplied import unsure_patches
from instok3d.types import Geometry


@dataclass(frozen=True)
class CheckedPhotos:
    """The photos that were kept, their matches, and what the checks found."""

    photos: PhotoSet
    compared: ComparedPhotos
    """On the device of the backbone."""
    points: list[CommonPoints]
    """Of the same pairs."""
    notes: list[str]
    """Warnings about photos or cameras, one sentence each."""


@dataclass(frozen=True)
class CheckedGeometry:
    """The photos that were kept, their geometry, and what the checks found."""

    photos: PhotoSet
    geometry: Geometry
    """On the device of the backbone."""
    notes: list[str]
    """Warnings about photos or cameras, one sentence each."""
    source: str
    """Where cameras and depth come from: the name of a backbone, "given", or "colmap" with the
    versions of what it uses."""
    unsure_patches: Bool[Tensor, " patch"] | None = None
    """Of all views, on the CPU: where a source is unsure of its depth. None without a source."""


def checked_geometry(
    backbone: GeometryBackbone,
    photos: PhotoSet,
    device: str | torch.device,
    source: GeometrySource | ColmapSource | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> CheckedGeometry:
    """Geometry of the photos that overlap with others; the rest is left out with a note.

    The checks need the pairwise matches of the nano backbone. With any other backbone all photos
    and cameras are taken as they are. If nothing is left out and the focal length that the photos
    state (EXIF) fits them, the geometry equals `backbone(photos.views)` bit for bit.

    Args:
        backbone: Predicts the geometry.
        photos: At least one.
        device: Where the backbone is.
        source: Another backbone or COLMAP, whose cameras and depth the first one takes as given.
            COLMAP chooses itself which photos overlap.
        progress: Called with how far COLMAP is.
    """
    if isinstance(source, ColmapSource):
        found = colmap_geometry(backbone, photos, device, progress)
        unsure = unsure_patches(found.supplied.unsure, backbone.patch_size).cpu()
        geometry = backbone(found.supplied.views)
        return CheckedGeometry(found.photos, geometry, found.notes, found.source, unsure)
    posed = photos.views.cam_from_world is not None
    name, notes = "given" if posed else own_name(backbone), []
    if isinstance(backbone, NanoBackbone):
        checked = check_photos(backbone, photos, device)
        photos, notes = checked.photos, checked.notes
        if source is None:
            photos, geometry, doubts = _solved(backbone, checked, device)
            return CheckedGeometry(photos, geometry, [*notes, *doubts], name)
    elif source is None:
        return CheckedGeometry(photos, backbone(photos.views.to(device)), notes, name)
    supplied = supplied_geometry(source, photos, device)
    unsure = unsure_patches(supplied.unsure, backbone.patch_size).cpu()
    return CheckedGeometry(photos, backbone(supplied.views), notes, source.name, unsure)


def check_photos(
    backbone: NanoBackbone, photos: PhotoSet, device: str | torch.device
) -> CheckedPhotos:
    """The photos that overlap with others, matched, and notes on the rest and on given cameras.

    Args:
        backbone: Matches the photos.
        photos: At least one.
        device: Where the backbone is.
    """
    # 1. Match the photos in pairs, and keep those that overlap.
    views = photos.views.to(device)
    compared = backbone.compare(views)
    points = find_common_points(compared.pairs, views.images[0])
    posed = views.cam_from_world is not None
    contrast = contrast_share(views.images[0])
    choice = choose_matching_views(points, contrast, photos.names, posed=posed)
    # 2. Features and depth of a view depend on all views: encode again without the others.
    if len(choice.kept) < len(photos.names):
        photos = photos.select(choice.kept)
        views = photos.views.to(device)
        compared = backbone.compare(views)
        points = find_common_points(compared.pairs, views.images[0])
    # 3. Compare given cameras with the matches.
    notes = choice.notes
    if views.cam_from_world is not None and views.intrinsics is not None:
        cameras, intrinsics = views.cam_from_world[0], views.intrinsics[0]
        notes = [*notes, *camera_notes(points, cameras, intrinsics, photos.names)]
    return CheckedPhotos(photos, compared, points, notes)


def _solved(
    backbone: NanoBackbone, checked: CheckedPhotos, device: str | torch.device
) -> tuple[PhotoSet, Geometry, list[str]]:
    """Geometry of the photos whose solved cameras their matches confirm, and notes on the rest.

    Given cameras are not solved for, and all photos stay.
    """
    notes: list[str] = []
    while True:
        photos, geometry, doubts = by_best_focal(backbone, checked.photos, checked.compared, device)
        if photos.views.cam_from_world is not None:
            return photos, geometry, [*notes, *doubts]
        cameras, intrinsics = (
            values[0].double()
            for values in (geometry.cameras.cam_from_world, geometry.cameras.intrinsics)
        )
        fits = [
            float(fit_share(pair, cameras, intrinsics)) if len(pair.pixels_a) else 0.0
            for pair in checked.points
        ]
        choice = choose_confirmed_views(checked.points, fits, photos.names)
        if len(choice.kept) == len(photos.names):
            return photos, geometry, [*notes, *choice.notes, *doubts]
        # Wrong cameras spoil the others and the depths: solve again without them, and check again.
        notes.append(choice.notes[0])
        checked = check_photos(backbone, checked.photos.select(choice.kept), device)
        notes += checked.notes
