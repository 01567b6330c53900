"""Focal lengths that photos state (EXIF): taken unless the photos themselves speak against them.

A photo that was cropped after it was taken keeps the focal length of the whole one.
"""

from dataclasses import replace

import torch

from instok3d.backbones.nano.backbone import ComparedPhotos, NanoBackbone
from instok3d.data.sample import photos_only
from instok3d.photos.loading import PhotoSet
from instok3d.types import Geometry

LEAST_SUPPORT = 0.98
"""Of the matches that fit with a solved focal length, so many must fit with the stated one.
docs/log.md, 2026-11-29: the true one always reaches it, one that is off by a third in a fifth of
the rooms."""


@torch.no_grad()
def by_best_focal(
    backbone: NanoBackbone, photos: PhotoSet, compared: ComparedPhotos, device: str | torch.device
) -> tuple[PhotoSet, Geometry, list[str]]:
    """Geometry with the stated focal length, or with a solved one if clearly more matches fit it.

    Where none is stated, or cameras are given, it is that of the backbone as it is.

    Args:
        backbone: Solves for the cameras.
        photos: At least one.
        compared: These photos with their intrinsics, if they have some.
        device: Where the backbone is.

    Returns:
        The photos, without intrinsics where those stated were wrong; the geometry; notes on it.
    """
    views = photos.views.to(device)
    stated = backbone(views, compared)
    if photos.intrinsics_source != "exif" or len(photos.names) < 2:  # one photo has no match
        return photos, stated, []
    free = photos_only(views, keep_intrinsics=False)
    compared_freely = backbone.compare(free)
    solved = backbone(free, compared_freely)
    for_stated = float(backbone.support(views, compared, stated)[0])
    for_solved = float(backbone.support(free, compared_freely, solved)[0])
    if for_stated >= LEAST_SUPPORT * for_solved:
        return photos, stated, []
    note = _disagreement(photos, stated, solved)
    bare = photos_only(photos.views, keep_intrinsics=False)
    return replace(photos, views=bare, intrinsics_source=None), solved, [note]


def _disagreement(photos: PhotoSet, stated: Geometry, solved: Geometry) -> str:
    """A note that says which focal length was taken instead of the stated one."""
    said, found = (
        float(photos.pixel_maps[0].intrinsics_to_original(each.cameras.intrinsics[0, 0])[0, 0])
        for each in (stated, solved)
    )
    return (
        f"the focal length that the photos state (EXIF; {said:.0f} pixels in {photos.names[0]}) "
        f"does not fit what they show, as after cropping; {found:.0f} pixels were found from them"
    )
