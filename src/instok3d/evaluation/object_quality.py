"""How whole and how pure the objects of a scene are, over its input views together.

AP asks for the masks of one picture. A user holds objects: one for each thing, all of it, nothing
else. These figures count that on the input views, where the objects are found.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.render import render
from instok3d.scene.id_maps import group_maps
from instok3d.scene.objects import likely_fragment
from instok3d.scene.sight import MIN_PIXELS
from instok3d.types import Cameras, Gaussians

WHOLE_IOU = 0.5
"""IoU with a true instance from which an object is that instance, and the instance is found."""
SMALL_SHARE = 0.01
"""Of the pixels of a view: an instance that is smaller in every view is small."""


@dataclass(frozen=True)
class FoundObjects:
    """The objects of a scene as its input views show them."""

    ids: Int[Tensor, "view height width"]
    """Number of the object that each pixel shows, -1 for none."""
    weights: Float[Tensor, "view object height width"]
    """Rendered weight of each object's own Gaussians: their part of alpha."""
    fragments: Bool[Tensor, " object"]
    """Which are likely pieces of things (`instok3d.scene.objects.likely_fragment`)."""


@dataclass(frozen=True)
class ObjectScore:
    """The objects of one sample against its true instances."""

    num_objects: int
    num_instances: int
    """Seen, which means that some view shows enough of them."""
    num_whole: int
    """Objects with an IoU of at least WHOLE_IOU with an instance."""
    num_found: int
    """Seen instances with which an object has such an IoU."""
    num_small: int
    """Small instances among the seen ones."""
    num_small_found: int
    num_fragments: int
    """Objects that are likely pieces of things."""
    num_whole_fragments: int
    """Fragments with such an IoU with an instance."""
    purities: tuple[float, ...]
    """Of each object: the share of its rendered weight in the instance where most of it lies."""
    weights: tuple[float, ...]
    """Of each object: its rendered weight on labelled pixels, pixels."""


@torch.no_grad()
def found_objects(
    gaussians: Gaussians,
    assignment: Float[Tensor, "anchor column"],
    cameras: Cameras,
    height: int,
    width: int,
    *,
    near: float,
    far: float,
) -> FoundObjects:
    """The objects that a scene of these groups has, by the rule of `instok3d.scene.scene.Scene`.

    Args:
        gaussians: One scene.
        assignment: Probabilities of each anchor, the void's last.
        cameras: Of the input views.
        height: Of the views, pixels.
        width: Of the views, pixels.
        near: Gaussians nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
    """
    columns = assignment.shape[1]
    views = [cameras.view(number) for number in range(len(cameras.intrinsics))]
    shown_groups = [
        group_maps(gaussians, assignment, view, height, width, near=near, far=far) for view in views
    ]
    winners = torch.stack([each.groups for each in shown_groups])
    scores = torch.stack([each.scores for each in shown_groups])
    pixels = torch.stack([each.flatten().bincount(minlength=columns) for each in winners])
    owner = assignment.argmax(dim=1)
    owned = owner[gaussians.anchor_index].bincount(minlength=columns) > 0
    chosen = ((pixels >= MIN_PIXELS).any(dim=0) & owned)[:-1].nonzero()[:, 0]
    number = torch.full((columns,), -1)
    number[chosen] = torch.arange(len(chosen))
    own = (owner[:, None] == chosen).to(assignment)
    maps = [
        render(gaussians, view, height, width, anchor_features=own, near=near, far=far).features
        for view in views
        if len(chosen)
    ]
    shown = [each for each in maps if each is not None]
    empty = assignment.new_zeros(len(views), 0, height, width)
    ids = number[winners]
    fragments = find_fragments(ids, scores, len(chosen))
    return FoundObjects(ids, torch.cat(shown) if shown else empty, fragments)


def find_fragments(
    ids: Int[Tensor, "view height width"], scores: Float[Tensor, "view height width"], count: int
) -> Bool[Tensor, " object"]:
    """Which objects a scene of these views would say to be fragments.

    Args:
        ids: Number of the object that each pixel shows, -1 for none; each number is shown.
        scores: Map of the winner at each pixel.
        count: Of the objects.
    """
    found = torch.zeros(count, dtype=torch.bool)
    for number in range(count):
        own = ids == number
        seen = own[own.flatten(1).sum(dim=1) >= MIN_PIXELS]
        rim = torch.cat([seen[:, [0, -1]].flatten(1), seen[:, :, [0, -1]].flatten(1)], dim=1)
        share = float(seen.double().flatten(1).mean(dim=1).max())
        cut_off = bool(rim.any(dim=1).all())
        found[number] = likely_fragment(float(scores[own].mean()), share, cut_off=cut_off)
    return found


def score_objects(
    true_ids: Int[Tensor, "view height width"], found: FoundObjects, *, min_instance_area: int
) -> ObjectScore | None:
    """Compare the objects of a sample with its instances, over all of its views together.

    1. Views without any known id are left out; of the others, unlabelled pixels (0 and -1) are
       left out of every area, and so are objects that lie on unlabelled pixels by more than half.
    2. IoU is that of the pixels in all views: a thing that is one object in one view and another
       one in the next is in two pieces.

    Args:
        true_ids: The same id is the same thing in every view; 0 = no instance, -1 = ignore.
        found: Objects in the same views.
        min_instance_area: Pixels that some view must show of an instance for it to count as seen.

    Returns:
        The counts; None where no view has a known id.
    """
    known = (true_ids > 0).flatten(1).any(dim=1)
    if not known.any():
        return None
    true_ids, ids, weights = true_ids[known], found.ids[known], found.weights[known]
    labelled = true_ids > 0
    instances = true_ids[labelled].unique()
    true = _one_hot(true_ids, instances)
    objects = _one_hot(ids, torch.arange(weights.shape[1]))
    inside = objects @ labelled.flatten().double()
    counted = (2 * inside >= objects.sum(dim=1)) & (inside > 0)
    overlap = (objects @ true.T)[counted]
    union = inside[counted][:, None] + true.sum(dim=1) - overlap
    good = overlap / union >= WHOLE_IOU
    area = true.view(len(instances), len(true_ids), -1).sum(dim=2).max(dim=1).values
    seen = area >= min_instance_area
    small = seen & (area < SMALL_SHARE * true_ids[0].numel())
    caught = good.any(dim=0)
    weight = (weights.transpose(0, 1).flatten(1).double() @ true.T)[counted]
    purity = weight.max(dim=1).values / weight.sum(dim=1).clamp_min(1e-9)
    return ObjectScore(
        num_objects=int(counted.sum()),
        num_instances=int(seen.sum()),
        num_whole=int(good.any(dim=1).sum()),
        num_found=int((seen & caught).sum()),
        num_small=int(small.sum()),
        num_small_found=int((small & caught).sum()),
        num_fragments=int(found.fragments[counted].sum()),
        num_whole_fragments=int((found.fragments[counted] & good.any(dim=1)).sum()),
        purities=tuple(purity.tolist()),
        weights=tuple(weight.sum(dim=1).tolist()),
    )


def _one_hot(
    ids: Int[Tensor, "view height width"], values: Int[Tensor, " value"]
) -> Float[Tensor, "value pixel"]:
    """1 where a pixel of the views has each value."""
    same: Bool[Tensor, "value pixel"] = ids.flatten() == values[:, None]
    return same.double()
