"""A scene of Gaussians that come from a file: without photos, views or a network's tokens."""

from collections.abc import Mapping, Sequence
from typing import Literal

import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.pictures import display_color
from instok3d.scene.boxes import describe_shape
from instok3d.scene.names import FILE, check_label, key_of
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import FAR, MAX_FAR, Provenance, SceneTokens, near_and_far
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import Vertical
from instok3d.types import Cameras, Gaussians, check_gaussians

PICTURE_SIDE = 512
"""Height and width of the pictures of an imported scene, pixels."""
MAX_ID = 4096
"""Of the objects of an imported scene: a group for each number up to the largest is kept."""
UNKNOWN_UP = Vertical((0.0, -1.0, 0.0), "file", 0.0)
"""What most splat files mean by up, since their worlds come from OpenCV cameras."""


@torch.no_grad()
def scene_from_gaussians(
    gaussians: Gaussians,
    object_ids: Int[Tensor, " gaussian"],
    *,
    provenance: Provenance,
    labels: Mapping[int, str] | None = None,
    units: Literal["metres", "arbitrary"] = "arbitrary",
    vertical: Vertical = UNKNOWN_UP,
    height: int = PICTURE_SIDE,
    width: int = PICTURE_SIDE,
    notes: Sequence[str] = (),
) -> Scene:
    """The scene of Gaussians whose objects are known; its Gaussians are sorted by object.

    It has no views. Each object has one anchor, in the mean of its Gaussians, with a token of no
    channels and probability 1; the rest has one that belongs to the void.

    Args:
        gaussians: Unbatched; anchor_index is not looked at.
        object_ids: Of each Gaussian: any whole numbers of at least 0; 0 is the rest. The objects
            keep them as their ids where the largest is at most MAX_ID; else they are numbered
            anew from 1 in rising order.
        provenance: Where they come from.
        labels: Names of objects, by the numbers in object_ids.
        units: Of their lengths.
        vertical: Which way is up; source "file".
        height: Of pictures of the scene, pixels.
        width: Likewise.
        notes: Warnings to be kept with the scene.

    Raises:
        ValueError: Gaussians that cannot be drawn, ids below 0 or not one for each Gaussian, or a
            label that is none.
    """
    check_gaussians(gaussians, "the scene")
    if len(object_ids) != len(gaussians.means) or (object_ids < 0).any():
        raise ValueError(
            f"object_ids must have one number of at least 0 for each of the {len(gaussians.means)} "
            f"Gaussians, got {len(object_ids)}, the least of them {min([0, *object_ids.tolist()])}"
        )
    found = [number for number in object_ids.unique().tolist() if number > 0]
    keeps = not found or found[-1] <= MAX_ID
    ids = found if keeps else list(range(1, len(found) + 1))
    rank = torch.searchsorted(torch.tensor(found, dtype=torch.long), object_ids)
    rank = torch.where(object_ids == 0, len(found), rank)
    order = rank.argsort(stable=True)
    rank = rank[order]
    gaussians = Gaussians(**{**vars(gaussians.rows(order)), "anchor_index": rank})
    counts = rank.bincount(minlength=len(found) + 1)
    num_groups = ids[-1] if ids else 0
    owners = torch.tensor([*(number - 1 for number in ids), num_groups])
    sums = torch.zeros(len(found) + 1, 3).index_add_(0, rank, gaussians.means.float())
    tokens = SceneTokens(
        positions=sums / counts.clamp_min(1)[:, None],
        anchors=torch.zeros(len(found) + 1, 0),
        groups=torch.zeros(num_groups, 0),
        assignment=torch.nn.functional.one_hot(owners, num_groups + 1).float(),
    )
    objects, start = [], 0
    for number, wanted, count in zip(ids, found, counts.tolist(), strict=False):
        own = gaussians.rows(slice(start, start + count))
        label = (labels or {}).get(wanted)
        objects.append(
            _described(own, number, start, None if label is None else check_label(label))
        )
        start += count
    cameras = Cameras(torch.zeros(0, 4, 4), torch.zeros(0, 3, 3))
    near, far = near_and_far(gaussians, cameras)
    # Splat files hold skies, many times as far away as the median Gaussian.
    reach = float(gaussians.means.abs().max()) if len(gaussians.means) else 0.0
    return Scene(
        gaussians=gaussians, tokens=tokens, cameras=cameras, height=height, width=width,
        objects=tuple(objects), views=(),
        photos=torch.zeros(0, height, width, 3, dtype=torch.uint8), units=units, frame="file",
        vertical=vertical, near_far=(near, min(MAX_FAR, max(far, FAR * reach))),
        warnings=tuple(notes), provenance=provenance,
    )  # fmt: skip


def _described(own: Gaussians, number: int, start: int, label: str | None) -> SceneObject:
    aabb, obb, centroid = describe_shape(own)
    return SceneObject(
        id=number,
        key=key_of(number, label),
        color=display_color(number),
        aabb=aabb,
        obb=obb,
        centroid=centroid,
        num_anchors=1,
        num_gaussians=len(own.means),
        gaussian_range=(start, len(own.means)),
        confidence=1.0,
        label=label,
        label_source=None if label is None else FILE,
    )
