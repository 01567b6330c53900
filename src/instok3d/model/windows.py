"""Many views in overlapping windows, and the groups of all windows as those of one scene.

Not in the paper, whose models see eight views at once. A small one groups a part of a room better
than the whole (docs/log.md), and time grows with the number of views, not with its square.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, relative_to_first, transform_points
from instok3d.geometry.moving import move_gaussians
from instok3d.geometry.view_path import order_along_path, view_overlaps
from instok3d.types import Anchors, Cameras, Gaussians, Geometry, TokenGroups, Views

SAME_GROUP_IOU = 0.15
"""Groups of two windows become one from this overlap on the anchors that both windows have."""


def view_windows(geometry: Geometry, scene: int, size: int) -> list[list[int]]:
    """Numbers of the views in each window: neighbours of a path through all views.

    First windows of `size`, then pairs, each begun one view after the one before: groups can be
    followed from one to the next, and an anchor's assignment is the mean over several windows. All
    come again with their views in the opposite order, seen from their last camera. What is found
    differs a little each time, and the mean is better (docs/log.md). Views that fit in one window
    are that window alone.

    Args:
        geometry: Of the whole batch; says which views see the same.
        scene: Which of the batch.
        size: Views of a window, at least 2.
    """
    with torch.autocast(geometry.depths.device.type, enabled=False):
        path = order_along_path(view_overlaps(geometry, scene))
    if len(path) <= size:
        return [path]
    windows = [
        path[start : start + length]
        for length in _lengths(size)
        for start in range(len(path) - length + 1)
    ]
    return windows + [window[::-1] for window in windows]


def window_lengths(views: int, size: int) -> list[int]:
    """How many views each window of `view_windows` has."""
    if views <= size:
        return [views]
    return [length for length in _lengths(size) for _ in range(views - length + 1)] * 2


def _lengths(size: int) -> tuple[int, ...]:
    return (size, 2) if size > 2 else (size,)


def cut_window(
    views: Views, geometry: Geometry, scene: int, window: Sequence[int]
) -> tuple[Views, Geometry]:
    """Photos and geometry of some views as a batch of one, their first camera as the world."""
    chosen = torch.as_tensor(window, device=views.images.device)

    def cut(values: Tensor) -> Tensor:
        return values[scene, chosen][None]

    cam_from_world = cut(geometry.cameras.cam_from_world)
    points = cut(geometry.pointmaps)
    with torch.autocast(points.device.type, enabled=False):
        cameras = Cameras(relative_to_first(cam_from_world), cut(geometry.cameras.intrinsics))
        points = transform_points(cam_from_world[:, 0], points.flatten(1, 3)).view_as(points)
    return Views(cut(views.images)), Geometry(
        features=cut(geometry.features),
        depths=cut(geometry.depths),
        pointmaps=points,
        confidences=cut(geometry.confidences),
        cameras=cameras,
    )


def join_windows(
    parts: Sequence[TokenGroups], windows: Sequence[Sequence[int]], geometry: Geometry, scene: int
) -> TokenGroups:
    """One scene out of its windows, a batch of one in the first camera's frame.

    Every view's anchors and Gaussians come from the largest window in whose middle it lies most.
    Groups of different windows that overlap on shared anchors are one group, whose token is the
    mean of theirs by the anchors they hold; never two groups of one window. An anchor's
    assignment is the mean over the windows it is in. In float32, also under autocast.
    Differentiable but for the choice of what is joined.

    Args:
        parts: The tokens of each window, batches of one.
        windows: The views of each window.
        geometry: Of all views of the whole batch.
        scene: Which of the batch.
    """
    patches = [
        _patches_of(part, window, geometry) for part, window in zip(parts, windows, strict=True)
    ]
    with torch.autocast(geometry.depths.device.type, enabled=False):
        groups = _groups_of(parts, patches, geometry.features.shape[1] * geometry.features.shape[2])
        owner = join_groups(groups.held, groups.covered, groups.window)
        numbers = torch.arange(int(owner.max()) + 1 if len(owner) else 0, device=owner.device)
        members = (owner[:, None] == numbers).float()  # row joined
        mass = groups.held.sum(dim=1)
        tokens = members.mT @ (groups.tokens * mass[:, None]) / (members.mT @ mass)[:, None]
        anchors, gaussians = _from_middles(parts, windows, patches, geometry, scene)
        own = anchors.patches[0]
        shares = groups.held.mT[own] @ members / groups.covered[:, own].sum(dim=0)[:, None]
        void = (1 - shares.sum(dim=1, keepdim=True)).clamp_min(0)
    return TokenGroups(
        anchors=anchors,
        tokens=tokens[None],
        assignment=torch.cat([shares, void], dim=1)[None],
        gaussians=gaussians,
        geometry=geometry,
    )


@torch.no_grad()
def join_groups(
    held: Float[Tensor, "row patch"],
    covered: Float[Tensor, "window patch"],
    window: Int[Tensor, " row"],
) -> Int[Tensor, " row"]:
    """The number of the joined group that each group of each window goes into.

    Pairs are joined in the order of their IoU on the patches that both windows have anchors on,
    down to SAME_GROUP_IOU, unless that would bring two groups of one window together.

    Args:
        held: How much of each patch's anchor every group has.
        covered: 1 where a window has an anchor.
        window: Where each group comes from.
    """
    both = held @ held.mT
    in_other = held @ covered[window].mT
    iou = both / (in_other + in_other.mT - both).clamp_min(1e-6)
    iou[window[:, None] == window] = 0
    first, second = torch.nonzero(torch.triu(iou, 1) > SAME_GROUP_IOU, as_tuple=True)
    best_first = iou[first, second].argsort(descending=True, stable=True)
    owner = list(range(len(held)))
    windows = [{one} for one in window.tolist()]
    for pair in best_first.tolist():
        kept, gone = sorted((owner[int(first[pair])], owner[int(second[pair])]))
        if kept != gone and not windows[kept] & windows[gone]:
            windows[kept] |= windows[gone]
            owner = [kept if one == gone else one for one in owner]
    return torch.as_tensor(owner, device=held.device).unique(return_inverse=True)[1]


def collate_scenes(scenes: Sequence[TokenGroups], geometry: Geometry) -> TokenGroups:
    """Scenes of one batch, filled up with empty groups to as many as the largest has.

    Raises:
        ValueError: They have unlike numbers of anchors.
    """
    counts = [scene.assignment.shape[1] for scene in scenes]
    if min(counts) != max(counts):
        raise ValueError(
            f"scenes of one batch came out with unlike numbers of anchors, {min(counts)} to "
            f"{max(counts)}; give one scene at a time, or raise num_anchors to the patches of a "
            "window"
        )
    most = max(scene.tokens.shape[1] for scene in scenes)
    return TokenGroups(
        anchors=Anchors(**_joined([scene.anchors for scene in scenes], dim=0)),
        tokens=torch.cat([_padded(scene.tokens.mT, most).mT for scene in scenes]),
        assignment=torch.cat(
            [
                torch.cat([_padded(s.assignment[..., :-1], most), s.assignment[..., -1:]], dim=-1)
                for s in scenes
            ]
        ),
        gaussians=Gaussians(**_joined([scene.gaussians for scene in scenes], dim=0)),
        geometry=geometry,
    )


@dataclass(frozen=True)
class _WindowGroups:
    """The groups of all windows that hold anything, one after the other."""

    held: Float[Tensor, "row patch"]
    tokens: Float[Tensor, "row channel"]
    window: Int[Tensor, " row"]
    covered: Float[Tensor, "window patch"]


def _patches_of(
    part: TokenGroups, window: Sequence[int], geometry: Geometry
) -> Int[Tensor, " anchor"]:
    """Which patch of all views each anchor of a window was placed on."""
    per_view = geometry.features.shape[2]
    patches = part.anchors.patches[0]
    views = torch.as_tensor(window, device=patches.device)
    return views[patches // per_view] * per_view + patches % per_view


def _groups_of(
    parts: Sequence[TokenGroups], patches: Sequence[Tensor], num_patches: int
) -> _WindowGroups:
    """Groups that hold an anchor's worth or win an anchor; what others hold goes to the void."""
    held, tokens, window, covered = [], [], [], []
    for number, (part, where) in enumerate(zip(parts, patches, strict=True)):
        pi = part.assignment[0, :, :-1].float()
        wins = part.assignment[0].argmax(dim=1).bincount(minlength=pi.shape[1] + 1)[:-1]
        kept = ((pi.sum(dim=0) >= 1) | (wins > 0)).nonzero()[:, 0]
        rows = pi.new_zeros(len(kept), num_patches)
        # Copies of an anchor (pad_duplicates) say the same of their patch: the last one stays.
        held.append(
            rows.index_put(
                (torch.arange(len(kept), device=where.device)[:, None], where[None]), pi[:, kept].mT
            )
        )
        tokens.append(part.tokens[0, kept].float())
        window.append(torch.full_like(kept, number))
        covered.append(pi.new_zeros(num_patches).index_fill(0, where, 1.0))
    return _WindowGroups(
        torch.cat(held), torch.cat(tokens), torch.cat(window), torch.stack(covered)
    )


def _from_middles(
    parts: Sequence[TokenGroups],
    windows: Sequence[Sequence[int]],
    patches: Sequence[Tensor],
    geometry: Geometry,
    scene: int,
) -> tuple[Anchors, Gaussians]:
    """Anchors and Gaussians of each view from the window in whose middle it lies most."""
    per_view = geometry.features.shape[2]
    chosen = _middle_windows(windows)
    anchors, gaussians, count = [], [], 0
    for number, (part, window, where) in enumerate(zip(parts, windows, patches, strict=True)):
        mine = [chosen[view] == number for view in range(len(chosen))]
        kept = torch.as_tensor(mine, device=where.device)[where // per_view]
        world_from_first = invert_rigid(geometry.cameras.cam_from_world[scene, window[0]])
        positions = transform_points(world_from_first, part.anchors.positions[0, kept])
        tokens = part.anchors.tokens[:, kept]
        anchors.append(Anchors(positions[None], tokens, where[None, kept]))
        rows = kept[part.gaussians.anchor_index[0]]
        own = Gaussians(**{name: value[0, rows] for name, value in vars(part.gaussians).items()})
        new_number = kept.cumsum(0) - 1 + count
        own = replace(own, anchor_index=new_number[own.anchor_index])
        gaussians.append(move_gaussians(own, world_from_first))
        count += int(kept.sum())
    drawn = {name: value[None] for name, value in _joined(gaussians, dim=0).items()}
    return Anchors(**_joined(anchors, dim=1)), Gaussians(**drawn)


def _middle_windows(windows: Sequence[Sequence[int]]) -> dict[int, int]:
    """For each view the largest window in whose middle it lies most, the first of equal ones."""
    distance: dict[int, tuple[int, float, int]] = {}
    for number, window in enumerate(windows):
        for place, view in enumerate(window):
            off = (-len(window), abs(place - (len(window) - 1) / 2), number)
            distance[view] = min(distance.get(view, off), off)
    return {view: number for view, (*_, number) in distance.items()}


def _padded(values: Tensor, count: int) -> Tensor:
    """With zeros behind the last column."""
    return torch.nn.functional.pad(values, (0, count - values.shape[-1]))


def _joined(items: Sequence[Anchors] | Sequence[Gaussians], *, dim: int) -> dict[str, Tensor]:
    return {name: torch.cat([vars(item)[name] for item in items], dim) for name in vars(items[0])}
