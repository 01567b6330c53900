"""Cameras by COLMAP and depth that fits them, for a model that takes both as given."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from instok3d.backbones.base import GeometryBackbone
from instok3d.model.memory import refuse_beyond
from instok3d.photos.loading import PhotoSet
from instok3d.scene.supplied import SuppliedGeometry, find_unsure, in_typical_lengths
from instok3d.sfm.colmap import RegisteredPhoto, pycolmap_module, register_photos
from instok3d.sfm.matches import MAX_SIDE, best_features, match_photos
from instok3d.sfm.sparse_depth import KnownPoints, fit_depth
from instok3d.types import Views

PEAK_BYTES = 1_500_000_000
"""Of a process that finds keypoints in photos of MAX_SIDE x MAX_SIDE, one after the other."""


@dataclass(frozen=True)
class ColmapSource:
    """Stands for `--geometry colmap`."""

    name: str = "colmap"
    sha256: str = ""
    """There are no weights of ours to name; the version of the package names them."""


@dataclass(frozen=True)
class ColmapGeometry:
    """The photos that COLMAP registered, with cameras and depth."""

    photos: PhotoSet
    supplied: SuppliedGeometry
    notes: list[str]
    """What was left out, one sentence each."""
    source: str
    """What found the cameras, with versions."""


def check_colmap(*, posed: bool) -> None:
    """Refuse COLMAP before any work is done.

    Args:
        posed: Whether the user gives cameras.

    Raises:
        ModuleNotFoundError: pycolmap is not installed.
        ValueError: Cameras are given.
    """
    if posed:
        raise ValueError(
            "geometry 'colmap' solves for the cameras, and cameras are given (--cameras): leave "
            "out one of the two"
        )
    pycolmap_module()


@torch.no_grad()
def colmap_geometry(
    backbone: GeometryBackbone,
    photos: PhotoSet,
    device: str | torch.device,
    progress: Callable[[str], None] = lambda text: None,
) -> ColmapGeometry:
    """Cameras of the photos by COLMAP, with the backbone's depth fitted to COLMAP's points.

    1. Match the whole photos, at up to MAX_SIDE pixels, and register them.
    2. Leave out the photos that did not register.
    3. Ask the backbone for depth in these cameras, and correct it towards the points.

    Args:
        backbone: Gives the dense depth.
        photos: Without cameras.
        device: Where the networks run.
        progress: Called with how far it is.

    Raises:
        ValueError: Fewer than two photos register, or they share too few points.
        NotEnoughMemoryError: It is predicted not to fit.
    """
    count = len(photos.names)
    if count < 2:
        raise ValueError(
            f"geometry 'colmap' needs two photos or more, got {count}: take --geometry nano"
        )
    refuse_beyond(
        PEAK_BYTES, what=f"keypoints of photos of {MAX_SIDE} x {MAX_SIDE} pixels", device="cpu",
        remedy=lambda limit: "take --geometry nano",
    )  # fmt: skip
    # 1. Cameras.
    features, notes = best_features(device)
    matches = match_photos(list(photos.paths), features, progress)
    registered = register_photos(matches, progress)
    if not registered:
        raise ValueError(
            f"no two of these {count} photos could be registered by COLMAP: take photos that share "
            "half of what they show from places a step apart, or take --geometry nano"
        )
    # 2. Photos.
    kept = [each.number for each in registered]
    missing = [name for number, name in enumerate(photos.names) if number not in kept]
    if missing:
        notes = [
            *notes,
            "left out, as COLMAP could not register them with the other photos: "
            f"{', '.join(missing)}",
        ]
    photos = photos.select(kept)
    # 3. Depth.
    progress("depth in the cameras of COLMAP")
    source = f"colmap (pycolmap {pycolmap_module().__version__}, {matches.features})"
    return ColmapGeometry(photos, _with_depth(backbone, photos, registered, device), notes, source)


def _with_depth(
    backbone: GeometryBackbone,
    photos: PhotoSet,
    registered: list[RegisteredPhoto],
    device: str | torch.device,
) -> SuppliedGeometry:
    rows = list(zip(photos.pixel_maps, registered, strict=True))
    intrinsics = [maps.intrinsics_to_model(each.intrinsics) for maps, each in rows]
    views = Views(
        photos.views.images,
        torch.stack(intrinsics)[None].float(),
        torch.stack([each.cam_from_world for each in registered])[None].float(),
    ).to(device)
    seen = backbone(views)
    known = [KnownPoints(maps.to_model(each.pixels), each.depths) for maps, each in rows]
    fitted = fit_depth(seen.depths[0].float().cpu(), known)
    depths = fitted.to(views.images)[None]
    unsure = find_unsure(depths, seen.confidences.float(), seen.cameras, name="colmap")
    views = replace(views, depths=torch.where(unsure, 0, depths))
    return SuppliedGeometry(in_typical_lengths(views), unsure[0])
