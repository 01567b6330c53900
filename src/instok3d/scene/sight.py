"""Where the input views show each object: pixels, best view; found late after an edit."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.scene.id_maps import group_maps
from instok3d.scene.record import SceneRecord
from instok3d.scene.run_lengths import RunLengths
from instok3d.scene.visibility import BestView, LateSight, Sight

MIN_PIXELS = 20
"""A group is an object only where it wins this many pixels of some input view."""


@dataclass(frozen=True)
class GroupSight:
    """What each group wins of the input views."""

    pixels: Int[Tensor, "view group"]
    scores: Float[Tensor, " group"]
    """Mean of the group's map over all the pixels that it wins; 0 for none."""
    boxes: Int[Tensor, "view group 4"]
    """x0, y0, x1, y1 around the pixels, exclusive at the end; zeros for none."""
    masks: Mapping[tuple[int, int], RunLengths]
    """By view and group, of those that win pixels."""

    def of_group(self, group: int) -> Sight:
        """What an object keeps of it."""
        pixels = self.pixels[:, group]
        visible_in = tuple((pixels >= MIN_PIXELS).nonzero()[:, 0].tolist())
        masks = tuple(self.masks[view, group] for view in visible_in)
        if not pixels.any():
            return Sight()
        best = int(pixels.argmax())
        x0, y0, x1, y1 = self.boxes[best, group].tolist()
        return Sight(visible_in, BestView(best, (x0, y0, x1, y1), int(pixels[best])), masks)


@torch.no_grad()
def look(scene: SceneRecord) -> GroupSight:
    """Pixels, scores, boxes and masks of every group, view by view; not differentiable."""
    num_groups, num_views = scene.tokens.groups.shape[0], len(scene.views)
    pixels = torch.zeros(num_views, num_groups + 1, dtype=torch.long)
    sums = torch.zeros(num_groups + 1)
    boxes = torch.zeros(num_views, num_groups + 1, 4, dtype=torch.long)
    masks: dict[tuple[int, int], RunLengths] = {}
    near, far = scene.near_far
    for view in range(num_views):
        maps = group_maps(
            scene.gaussians, scene.tokens.assignment, scene.cameras.view(view),
            scene.height, scene.width, near=near, far=far,
        )  # fmt: skip
        winners = maps.groups.cpu()
        pixels[view] = winners.flatten().bincount(minlength=num_groups + 1)
        sums.index_add_(0, winners.flatten(), maps.scores.cpu().flatten())
        for group in winners.unique().tolist():
            own = winners == group
            y, x = own.nonzero(as_tuple=True)
            low_high = [x.min(), y.min(), x.max() + 1, y.max() + 1]
            boxes[view, group] = torch.stack(low_high)
            masks[view, group] = RunLengths.of(own)
    scores = sums / pixels.sum(0).clamp_min(1)
    return GroupSight(pixels[:, :num_groups], scores[:num_groups], boxes[:, :num_groups], masks)


class SharedLook:
    """One look at a scene for all of its objects, when the first of them is asked for its sight."""

    def __init__(self, scene: SceneRecord) -> None:
        self._scene = scene

    @cached_property
    def _found(self) -> GroupSight:
        return look(self._scene)

    def of_object(self, number: int) -> LateSight:
        """Where an object is seen, by its id."""
        return LateSight(lambda: self._found.of_group(number - 1))


def looked_at_later(scene: SceneRecord) -> SceneRecord:
    """The scene with all that says where its objects are seen to be found when it is asked for."""
    shared = SharedLook(scene)
    objects = (replace(item, sight=shared.of_object(item.id)) for item in scene.objects)
    return replace(scene, objects=tuple(objects))
