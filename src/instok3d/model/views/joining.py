"""Merging the groups of overlapping windows into the groups of one scene."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.moving import move_gaussians
from instok3d.model.views.windows import middle_windows
from instok3d.types import Anchors, Gaussians, Geometry, TokenGroups

SAME_GROUP_IOU = 0.15
"""Groups of two windows are merged from this IoU on, measured on the patches they share."""


@dataclass(frozen=True)
class WindowGroups:
    """The groups of one window that own any anchor, as soft masks over its patches."""

    held: Float[Tensor, "row patch"]
    """Assignment probability of each patch's anchor to each group."""
    patches: Int[Tensor, " patch"]
    """Index of each patch among the patches of all views; no duplicates."""
    tokens: Float[Tensor, "row channel"]


def join_windows(
    parts: Sequence[TokenGroups], windows: Sequence[Sequence[int]], geometry: Geometry, scene: int
) -> TokenGroups:
    """One scene from the tokens of its windows: a batch of one in the first camera's frame.

    Runs in float32, also under autocast. Differentiable, except for the choice of the groups that
    are merged.

    Args:
        parts: The tokens of each window, batches of one; Gaussians and what is lifted are taken
            from `middle_windows` alone.
        windows: The view indices of each window.
        geometry: Of all views of the whole batch.
        scene: Index in the batch.
    """
    num_patches = geometry.features.shape[1] * geometry.features.shape[2]
    patches = [
        _patches_of(part, window, geometry) for part, window in zip(parts, windows, strict=True)
    ]
    with torch.autocast(geometry.depths.device.type, enabled=False):
        # 1. Match groups across windows by their overlap on shared patches.
        groups = [_groups_of(part, where) for part, where in zip(parts, patches, strict=True)]
        owners = join_groups(groups, num_patches)
        count = max((int(owner.max()) + 1 for owner in owners if len(owner)), default=0)
        numbers = torch.arange(count, device=geometry.depths.device)
        # 2. Sum assignments over windows; tokens are averaged with the assigned mass as weight.
        shares = groups[0].held.new_zeros(num_patches, count)
        covered = groups[0].held.new_zeros(num_patches, 1)
        mass = groups[0].held.new_zeros(count, 1)
        tokens = groups[0].tokens.new_zeros(count, groups[0].tokens.shape[1])
        for group, owner in zip(groups, owners, strict=True):
            members = (owner[:, None] == numbers).float()  # [row, merged group]
            shares.index_add_(0, group.patches, group.held.mT @ members)
            covered[group.patches] += 1
            weights = members.mT * group.held.sum(dim=1)
            mass += weights.sum(dim=1, keepdim=True)
            tokens += weights @ group.tokens
        # 3. Each view takes its anchors and Gaussians from one window.
        anchors, gaussians = _from_middles(parts, windows, patches, geometry, scene)
        # 4. An anchor's assignment is the mean over the windows that contain its patch.
        own = anchors.patches[0]
        shares = shares[own] / covered[own]
        void = (1 - shares.sum(dim=1, keepdim=True)).clamp_min(0)
    return TokenGroups(
        anchors=anchors,
        tokens=(tokens / mass)[None],
        assignment=torch.cat([shares, void], dim=1)[None],
        gaussians=gaussians,
        geometry=geometry,
    )


@torch.no_grad()
def join_groups(windows: Sequence[WindowGroups], num_patches: int) -> list[Int[Tensor, " row"]]:
    """For each window, the index of the merged group that each of its groups goes into.

    Greedy agglomeration: pairs of groups are visited by falling IoU, down to SAME_GROUP_IOU, and
    merged unless two groups of the same window would end up in one (a window tells its own groups
    apart).

    Args:
        windows: The groups of each window.
        num_patches: Of all views.
    """
    counts = [len(window.held) for window in windows]
    owner = list(range(sum(counts)))
    holds = [{number} for number, count in enumerate(counts) for _ in range(count)]
    members = [[row] for row in owner]
    for first, second in _pairs_best_first(windows, num_patches):
        kept, gone = sorted((owner[first], owner[second]))
        if kept != gone and not holds[kept] & holds[gone]:
            holds[kept] |= holds[gone]
            members[kept] += members[gone]
            for row in members[gone]:
                owner[row] = kept
    device = windows[0].held.device
    numbers = torch.as_tensor(owner, dtype=torch.long, device=device)
    return list(numbers.unique(return_inverse=True)[1].split(counts))


def _pairs_best_first(windows: Sequence[WindowGroups], num_patches: int) -> list[list[int]]:
    """Pairs of groups of different windows with enough IoU, best first.

    Groups are numbered through all windows.
    """
    column = torch.full((num_patches,), -1, device=windows[0].patches.device)
    pairs, overlaps, before = [column.new_zeros(0, 2)], [windows[0].held.new_zeros(0)], 0
    for number, window in enumerate(windows):
        column[window.patches] = torch.arange(len(window.patches), device=column.device)
        later = before + len(window.held)
        for other in windows[number + 1 :]:
            at = column[other.patches]
            shared = at >= 0
            if not shared.any():
                later += len(other.held)
                continue
            mine, theirs = window.held[:, at[shared]], other.held[:, shared]
            both = mine @ theirs.mT
            either = mine.sum(dim=1)[:, None] + theirs.sum(dim=1) - both
            iou = both / either.clamp_min(1e-6)
            found = (iou > SAME_GROUP_IOU).nonzero()
            pairs.append(found + found.new_tensor([before, later]))
            overlaps.append(iou[found[:, 0], found[:, 1]])
            later += len(other.held)
        column[window.patches] = -1
        before += len(window.held)
    order = torch.cat(overlaps).argsort(descending=True, stable=True)
    return torch.cat(pairs)[order].tolist()


def collate_scenes(scenes: Sequence[TokenGroups], geometry: Geometry) -> TokenGroups:
    """Scenes as one batch; empty groups pad them to the largest number of groups.

    Raises:
        ValueError: They differ in the number of anchors.
    """
    counts = [scene.assignment.shape[1] for scene in scenes]
    if min(counts) != max(counts):
        raise ValueError(
            f"the scenes of a batch have different numbers of anchors, {min(counts)} to "
            f"{max(counts)}; give one scene at a time, or raise num_anchors to the patches of a "
            "window"
        )
    most = max(scene.tokens.shape[1] for scene in scenes)
    return TokenGroups(
        anchors=Anchors.concatenate([scene.anchors for scene in scenes]),
        tokens=torch.cat([_padded(scene.tokens.mT, most).mT for scene in scenes]),
        assignment=torch.cat(
            [
                torch.cat([_padded(s.assignment[..., :-1], most), s.assignment[..., -1:]], dim=-1)
                for s in scenes
            ]
        ),
        gaussians=Gaussians.concatenate([scene.gaussians for scene in scenes]),
        geometry=geometry,
    )


def _patches_of(
    part: TokenGroups, window: Sequence[int], geometry: Geometry
) -> Int[Tensor, " anchor"]:
    """The patch of each anchor of a window, as an index among the patches of all views."""
    per_view = geometry.features.shape[2]
    patches = part.anchors.patches[0]
    views = torch.as_tensor(window, device=patches.device)
    return views[patches // per_view] * per_view + patches % per_view


def _groups_of(part: TokenGroups, where: Int[Tensor, " anchor"]) -> WindowGroups:
    """Groups with an assigned mass of at least one anchor, or that win an anchor.

    The mass of all others goes to the void.
    """
    pi = part.assignment[0, :, :-1].float()
    wins = part.assignment[0].argmax(dim=1).bincount(minlength=pi.shape[1] + 1)[:-1]
    kept = ((pi.sum(dim=0) >= 1) | (wins > 0)).nonzero()[:, 0]
    # Copies of an anchor (pad_duplicates) have equal assignments: keep the last one.
    patches, copy_of = where.unique(return_inverse=True)
    last = torch.zeros_like(patches).scatter_reduce(
        0, copy_of, torch.arange(len(where), device=where.device), "amax"
    )
    return WindowGroups(pi[last][:, kept].mT, patches, part.tokens[0, kept].float())


def _from_middles(
    parts: Sequence[TokenGroups],
    windows: Sequence[Sequence[int]],
    patches: Sequence[Tensor],
    geometry: Geometry,
    scene: int,
) -> tuple[Anchors, Gaussians]:
    """Anchors and Gaussians of each view, from the longest window centred nearest to it."""
    per_view = geometry.features.shape[2]
    chosen = middle_windows(windows)
    anchors, gaussians, count = [], [], 0
    for number, (part, window, where) in enumerate(zip(parts, windows, patches, strict=True)):
        if number not in chosen.values():
            continue
        mine = [chosen[view] == number for view in range(len(chosen))]
        kept = torch.as_tensor(mine, device=where.device)[where // per_view]
        world_from_first = invert_rigid(geometry.cameras.cam_from_world[scene, window[0]])
        positions = transform_points(world_from_first, part.anchors.positions[0, kept])
        own = part.anchors.map(lambda values, kept=kept: values[:, kept])
        anchors.append(replace(own, positions=positions[None], patches=where[None, kept]))
        rows = kept[part.gaussians.anchor_index[0]]
        drawn = part.gaussians.scene(0).rows(rows)
        new_number = kept.cumsum(0) - 1 + count
        drawn = replace(drawn, anchor_index=new_number[drawn.anchor_index])
        gaussians.append(move_gaussians(drawn, world_from_first))
        count += int(kept.sum())
    joined = Gaussians.concatenate(gaussians)
    return Anchors.concatenate(anchors, axis=1), joined.batched()


def _padded(values: Tensor, count: int) -> Tensor:
    """Zeros are appended up to `count` columns."""
    return torch.nn.functional.pad(values, (0, count - values.shape[-1]))
