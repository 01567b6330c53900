"""Whole objects, not crumbs: what the groups of a scene are before they become objects.

A network spreads a chair over two groups, or leaves a crumb of a table to a group of its own. Its
probabilities say so: the pixels that such a crumb wins have a good part of the table's map. Done
where a scene is made, on what its input views show; no network, no optimisation. Not in the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from instok3d.refinement.assignment import reassigned
from instok3d.render import render
from instok3d.scene.contacts import Contacts, find_contacts
from instok3d.scene.record import CleanUpRecord, SceneTokens
from instok3d.scene.regions import connected_regions
from instok3d.types import Cameras, Gaussians

JOIN_SCORE = 0.6
"""From which a group joins a larger one (`_affinity`). Tuned on rooms, docs/log.md, 2026-11-30."""
PIECE_SCORE = 0.2
"""From which a loose piece of a group goes to another one."""
CRUMB_SCORE = 0.2
"""From which a crumb joins another group."""
UNSURE = 0.5
"""A crumb's own map, mean over the pixels that it wins, is below this."""
CRUMB_SHARE = 0.0125
"""Of the pixels of a view: a crumb wins no more in any view."""
COLOR_RANGE = 0.4
"""Difference of mean colours, sRGB, at which two groups are never one thing."""
MAIN_SHARE = 0.5
"""Of the pixels that a group wins in a view: a larger region is its main part there."""


@dataclass(frozen=True)
class Cleaned:
    """A scene's Gaussians and tokens with other owners; nothing else of them is changed."""

    gaussians: Gaussians
    """anchor_index may differ."""
    tokens: SceneTokens
    """The assignment may differ. A group that joined another one has no probability left."""
    record: CleanUpRecord


@dataclass(frozen=True)
class _Look:
    """One input view."""

    maps: Float[Tensor, "column height width"]
    """Of the groups, and of the void with what is not covered."""
    winners: Int[Tensor, "height width"]
    depths: Float[Tensor, "height width"]
    colors: Float[Tensor, "3 height width"]

    def joined(self, joins: "_Joins") -> "_Look":
        """The same view once groups have joined others."""
        maps = _joined(self.maps, joins)
        return replace(self, maps=maps, winners=maps.argmax(dim=0))


@dataclass(frozen=True)
class _Shown:
    """What regions of all views show: their pixels' means."""

    pixels: Float[Tensor, " region"]
    maps: Float[Tensor, "region column"]
    colors: Float[Tensor, "region 3"]
    contacts: Contacts


@torch.no_grad()
def cleaned(
    gaussians: Gaussians,
    tokens: SceneTokens,
    cameras: Cameras,
    height: int,
    width: int,
    *,
    near: float,
    far: float,
) -> Cleaned:
    """Groups that hold one thing joined, and Gaussians given to the group that they show.

    1. A group joins the larger one whose map is strong on its pixels, whose surface goes on there
       and whose colour is alike. A small thing that stands out, a cup on a table, stays.
    2. A crumb, a small group that is unsure of its own pixels, joins another one on less evidence.
    3. Of what a group wins in a view, regions apart from its main part are loose pieces. Where the
       map and the surface of a group around it say so, a piece is that group's.
    4. A Gaussian whose visible weight lies mostly in the pixels of another group goes to it, to
       its nearest anchor: the loose pieces, and haloes at the rim of an object.

    Not differentiable.

    Args:
        gaussians: One scene.
        tokens: Its anchors and groups.
        cameras: Of the input views.
        height: Of the views, pixels.
        width: Of the views, pixels.
        near: Gaussians nearer than this z-depth are not drawn, scene units.
        far: Nor are those farther than this.
    """
    if not len(gaussians.means) or not len(tokens.groups):
        return Cleaned(gaussians, tokens, CleanUpRecord(0, 0))

    views = [cameras.view(number) for number in range(len(cameras.intrinsics))]
    looks = [_look(gaussians, tokens.assignment, v, height, width, near, far) for v in views]
    assignment, count = tokens.assignment, 0
    for find in (_joins_of_parts, _joins_of_crumbs):
        joins = find(looks)
        assignment = _joined(assignment.mT, joins).mT.contiguous()
        # Composited maps are linear in the assignment: no need to render them again.
        looks = [look.joined(joins) for look in looks] if joins else looks
        count += len(joins)
    labels = _without_loose_pieces(looks)
    moved = reassigned(
        gaussians, assignment, tokens.positions, cameras, height, width, near=near, far=far,
        winners=labels,
    )  # fmt: skip
    others = int((moved.anchor_index != gaussians.anchor_index).sum())
    record = CleanUpRecord(count, others)
    return Cleaned(moved, replace(tokens, assignment=assignment), record)


def _look(
    gaussians: Gaussians,
    assignment: Float[Tensor, "anchor column"],
    camera: Cameras,
    height: int,
    width: int,
    near: float,
    far: float,
) -> _Look:
    picture = render(
        gaussians, camera, height, width, anchor_features=assignment, near=near, far=far
    )
    assert picture.features is not None
    maps = picture.features[0]
    maps = torch.cat([maps[:-1], maps[-1:] + (1 - picture.alphas)])
    return _Look(maps, maps.argmax(dim=0), picture.depths[0], picture.colors[0])


_Joins = Sequence[tuple[int, int]]
"""Groups and the larger ones that they join, in the order in which they do."""


def _joined(rows: Float[Tensor, "column *each"], joins: _Joins) -> Float[Tensor, "column *each"]:
    """What the groups have, with that of each that joins another one given to it."""
    rows = rows.clone() if joins else rows
    for group, target in joins:
        rows[target] += rows[group]
        rows[group] = 0
    return rows


def _joins_of_parts(looks: Sequence[_Look]) -> _Joins:
    """Groups that are parts of larger ones."""
    columns = len(looks[0].maps)
    shown = _shown(looks, [look.winners for look in looks], columns)
    score = _affinity(shown, torch.arange(columns), shown.colors, mutual=True)
    return _joins(shown.pixels, score.where(score > JOIN_SCORE, 0.0))


def _joins_of_crumbs(looks: Sequence[_Look]) -> _Joins:
    """Crumbs, and the groups that they belong to."""
    columns = len(looks[0].maps)
    shown = _shown(looks, [look.winners for look in looks], columns)
    pixels = [look.winners.flatten().cpu().bincount(minlength=columns) for look in looks]
    small = torch.stack(pixels).amax(dim=0) <= CRUMB_SHARE * looks[0].winners.numel()
    crumbs = small & (shown.maps.diagonal() < UNSURE)
    score = _affinity(shown, torch.arange(columns), shown.colors, mutual=False)
    score[~crumbs], score[:, crumbs] = 0, 0
    return _joins(shown.pixels, score.where(score > CRUMB_SCORE, 0.0))


def _joins(pixels: Float[Tensor, " column"], score: Float[Tensor, "column column"]) -> _Joins:
    """Each group with the larger one of its best score, smaller groups first.

    The void, the last column, neither takes nor joins; nor is anything joined where the score is 0.
    """
    # Larger groups take smaller ones, so that there is no circle; of equal ones the first takes.
    order = (-pixels).argsort(stable=True)
    rank = torch.empty_like(order)
    rank[order] = torch.arange(len(order))
    score = score.masked_fill(rank[None, :] >= rank[:, None], 0)
    score[-1], score[:, -1] = 0, 0
    best, target = score.max(dim=1)
    return [(group, int(target[group])) for group in reversed(order.tolist()) if best[group] > 0]


def _without_loose_pieces(looks: Sequence[_Look]) -> Int[Tensor, "view height width"]:
    """The winner of each pixel, with the loose pieces given to the group around them."""
    columns = looks[0].maps.shape[0] if looks else 0
    regions, owners, mains = [], [], []
    for look in looks:
        region, owner, main = _regions(look.winners, first=len(owners))
        regions.append(region)
        owners += owner
        mains += main
    owner, main = torch.tensor(owners), torch.tensor(mains, dtype=torch.bool)
    shown = _shown(looks, regions, len(owners))
    group_colors = _shown(looks, [look.winners for look in looks], columns).colors
    score = _affinity(shown, owner, group_colors, mutual=False)
    score[:, -1] = 0
    best, target = score.max(dim=1)
    loose = ~main & (owner != columns - 1) & (best > PIECE_SCORE)
    return torch.where(loose, target, owner)[torch.stack(regions)]


def _regions(
    winners: Int[Tensor, "height width"], *, first: int
) -> tuple[Int[Tensor, "height width"], list[int], list[bool]]:
    """Connected regions of one winner, numbered from `first`: their group, and if they are main."""
    # 1. The regions by their group, those of one group in reading order.
    roots, region, sizes = connected_regions(winners).unique(
        return_inverse=True, return_counts=True
    )
    order = winners.flatten()[roots].argsort(stable=True)
    owner, sizes = winners.flatten()[roots[order]], sizes[order]
    place = torch.empty_like(order).scatter_(0, order, torch.arange(len(order)).to(order))
    # 2. A region is main if it holds MAIN_SHARE of its group's pixels.
    group = owner.unique(return_inverse=True)[1]
    whole = torch.zeros_like(sizes).index_add(0, group, sizes)
    mains = sizes >= MAIN_SHARE * whole[group]
    return first + place[region], owner.tolist(), mains.tolist()


def _shown(
    looks: Sequence[_Look], regions: Sequence[Int[Tensor, "height width"]], count: int
) -> _Shown:
    """What the regions show, over the views together; zeros for a region without pixels."""
    columns = looks[0].maps.shape[0] if looks else 0
    pixels, maps, colors = torch.zeros(count), torch.zeros(count, columns), torch.zeros(count, 3)
    contacts = Contacts(torch.zeros(count, columns), torch.zeros(count, columns))
    for look, region in zip(looks, regions, strict=True):
        flat = region.flatten().cpu()
        pixels += flat.bincount(minlength=count)
        maps.index_add_(0, flat, look.maps.flatten(1).T.cpu())
        colors.index_add_(0, flat, look.colors.flatten(1).T.cpu())
        contacts += find_contacts(
            region.cpu(), look.winners.cpu(), look.depths.cpu(), count, columns
        )
    size = pixels.clamp_min(1)[:, None]
    return _Shown(pixels, maps / size, colors / size, contacts)


def _affinity(
    shown: _Shown,
    owner: Int[Tensor, " region"],
    group_colors: Float[Tensor, "column 3"],
    *,
    mutual: bool,
) -> Float[Tensor, "region column"]:
    """How much each region looks like a part of each group that it touches.

    The group's map on the region's pixels, relative to that of the region's own group; times the
    share of their border across which the surface goes on; less by the difference of their colours.

    Args:
        shown: Of the regions.
        owner: Of each region; itself has no affinity.
        group_colors: Mean of each group.
        mutual: Add the map of the region's group on the other's pixels (regions are groups then).
    """
    own = shown.maps.gather(1, owner[:, None]).clamp_min(1e-6)
    maps = shown.maps + shown.maps.T if mutual else shown.maps
    surface = shown.contacts.surface / shown.contacts.border.clamp_min(1)
    difference = (shown.colors[:, None] - group_colors[None]).abs().mean(dim=2)
    score = maps / own * surface * (1 - difference / COLOR_RANGE).clamp_min(0)
    return score.scatter(1, owner[:, None], 0.0)
