"""Which Gaussians belong to which object after an edit: the invariants of a scene, kept.

Gaussians are sorted by object and each object has one range of them. An object's id is its group's
row + 1, so that groups are added but never taken away. A Gaussian's owner is the group with the
largest probability of its anchor. An edit that gives single Gaussians to another object gives them
a copy of their anchor with another row of the assignment.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from instok3d.scene import semantics
from instok3d.scene.boxes import describe_shape
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import SceneRecord, SceneTokens
from instok3d.scene.semantics import NO_SEMANTICS, SceneSemantics
from instok3d.scene.sight import looked_at_later
from instok3d.types import Gaussians


@dataclass(frozen=True)
class Part:
    """An object by itself, with the anchors that its Gaussians came from."""

    gaussians: Gaussians
    """anchor_index counts the part's own anchors."""
    positions: Float[Tensor, "anchor 3"]
    anchors: Float[Tensor, "anchor channel"]
    group: Float[Tensor, " channel"]
    semantics: Mapping[str, SceneSemantics] = field(default_factory=lambda: NO_SEMANTICS)
    """Of the anchors and of one group, this one."""


def part_of(scene: SceneRecord, item: SceneObject) -> Part:
    """One object of a scene by itself."""
    start, count = item.gaussian_range
    gaussians = scene.gaussians.rows(slice(start, start + count))
    used, own_index = gaussians.anchor_index.unique(return_inverse=True)
    return Part(
        replace(gaussians, anchor_index=own_index),
        scene.tokens.positions[used],
        scene.tokens.anchors[used],
        scene.tokens.groups[item.id - 1],
        semantics.of_part(scene.semantics, item.id - 1, used),
    )


def owners(tokens: SceneTokens) -> Int[Tensor, " anchor"]:
    """The group of each anchor; the number of groups for the void."""
    return tokens.assignment.argmax(dim=1)


def row_ids(scene: SceneRecord) -> Int[Tensor, " gaussian"]:
    """The id of the object of each Gaussian, 0 for the rest."""
    ids = torch.zeros(len(scene.gaussians.means), dtype=torch.long)
    for item in scene.objects:
        start, count = item.gaussian_range
        ids[start : start + count] = item.id
    return ids


def drawn_rows(scene: SceneRecord) -> Bool[Tensor, " gaussian"]:
    """Which Gaussians are drawn: all but those of hidden objects."""
    drawn = torch.ones(len(scene.gaussians.means), dtype=torch.bool)
    for item in scene.objects:
        if item.hidden:
            start, count = item.gaussian_range
            drawn[start : start + count] = False
    return drawn


def with_group(tokens: SceneTokens, token: Float[Tensor, " channel"]) -> SceneTokens:
    """The tokens with one more group, to which no anchor belongs yet."""
    pi = tokens.assignment
    column = pi.new_zeros(len(pi), 1)
    return replace(
        tokens,
        groups=torch.cat([tokens.groups, token[None]]),
        assignment=torch.cat([pi[:, :-1], column, pi[:, -1:]], dim=1),
    )


def without_rows(
    scene: SceneRecord, dropped: Bool[Tensor, " gaussian"], gone: Collection[int] = ()
) -> SceneRecord:
    """The scene without some Gaussians, and without the anchors of the objects that are gone.

    Args:
        scene: What is edited.
        dropped: The Gaussians.
        gone: Ids of objects all of whose Gaussians are among them; 0 for the rest.
    """
    groups = {number - 1 for number in gone if number}
    if 0 in gone:
        groups |= set(range(len(scene.tokens.groups) + 1)) - {i.id - 1 for i in scene.objects}
    kept_anchors = ~torch.isin(owners(scene.tokens), torch.tensor(sorted(groups), dtype=torch.long))
    number = kept_anchors.cumsum(0) - 1
    gaussians = scene.gaussians.rows(~dropped)
    tokens = replace(
        scene.tokens,
        positions=scene.tokens.positions[kept_anchors],
        anchors=scene.tokens.anchors[kept_anchors],
        assignment=scene.tokens.assignment[kept_anchors],
    )
    scene = replace(
        scene, semantics=semantics.with_anchors(scene.semantics, kept_anchors.nonzero()[:, 0])
    )
    lost = row_ids(scene)[dropped].bincount(minlength=len(scene.tokens.groups) + 1)
    counts = {item.id: item.num_gaussians - int(lost[item.id]) for item in scene.objects}
    changed = {item.id for item in scene.objects if lost[item.id] and counts[item.id]}
    return rebuilt(
        scene, replace(gaussians, anchor_index=number[gaussians.anchor_index]), tokens,
        scene.objects, counts, changed,
    )  # fmt: skip


def with_part(scene: SceneRecord, part: Part, item: SceneObject) -> SceneRecord:
    """The scene with one more object: a part, whose anchors belong to a new group alone.

    Args:
        scene: What is edited.
        part: Anchors and group of as many channels as the scene's.
        item: Its key, label, colour and confidence; the id is the next one.
    """
    tokens = with_group(scene.tokens, part.group)
    pi = tokens.assignment.new_zeros(len(part.positions), tokens.assignment.shape[1])
    pi[:, item.id - 1] = 1
    num_anchors = len(tokens.positions)
    tokens = replace(
        tokens,
        positions=torch.cat([tokens.positions, part.positions]),
        anchors=torch.cat([tokens.anchors, part.anchors]),
        assignment=torch.cat([tokens.assignment, pi]),
    )
    known = semantics.with_part(scene.semantics, part.semantics, len(part.positions))
    scene = replace(scene, semantics=known)
    added = replace(part.gaussians, anchor_index=part.gaussians.anchor_index + num_anchors)
    old, added = same_degree(scene.gaussians, added)
    end = sum(each.num_gaussians for each in scene.objects)
    gaussians = Gaussians.concatenate(
        [old.rows(slice(0, end)), added, old.rows(slice(end, len(old.means)))]
    )
    counts = {each.id: each.num_gaussians for each in scene.objects}
    counts[item.id] = len(added.means)
    return rebuilt(scene, gaussians, tokens, (*scene.objects, item), counts, {item.id})


def with_more(scene: SceneRecord, more: Gaussians) -> SceneRecord:
    """The scene with more Gaussians of its own anchors, each at the end of its owner's.

    Args:
        scene: What is edited.
        more: anchor_index names anchors of the scene, which say whose they are.

    Raises:
        ValueError: An anchor is not there.
    """
    if not len(more.means):
        return scene
    owner = owners(scene.tokens)
    if int(more.anchor_index.max()) >= len(owner):
        raise ValueError(f"anchor_index up to {int(more.anchor_index.max())} of {len(owner)}")
    known = torch.tensor([0, *(item.id for item in scene.objects)])
    ids = owner[more.anchor_index] + 1
    ids = torch.cat([row_ids(scene), torch.where(torch.isin(ids, known), ids, 0)])
    order = torch.where(ids == 0, len(scene.tokens.groups) + 1, ids).argsort(stable=True)
    gaussians = Gaussians.concatenate(list(same_degree(scene.gaussians, more))).rows(order)
    totals = ids.bincount(minlength=len(scene.tokens.groups) + 1).tolist()
    counts = {item.id: totals[item.id] for item in scene.objects}
    changed = set(ids[len(scene.gaussians.means) :].tolist()) - {0}
    return rebuilt(scene, gaussians, scene.tokens, scene.objects, counts, changed)


def same_degree(first: Gaussians, second: Gaussians) -> tuple[Gaussians, Gaussians]:
    """Both with as many colour coefficients; those that one lacks are zeros."""
    count = max(first.sh.shape[1], second.sh.shape[1])

    def padded(gaussians: Gaussians) -> Gaussians:
        missing = count - gaussians.sh.shape[1]
        if not missing:
            return gaussians
        return replace(gaussians, sh=torch.nn.functional.pad(gaussians.sh, (0, 0, 0, missing)))

    return padded(first), padded(second)


def given_to(
    scene: SceneRecord, chosen: Bool[Tensor, " gaussian"], item: SceneObject
) -> SceneRecord:
    """The scene with some Gaussians given to an object, old or new (then with the next id).

    An anchor all of whose Gaussians go goes along; of others a copy goes. In its row the new owner
    gets the probability of the old one.
    """
    tokens, index = scene.tokens, scene.gaussians.anchor_index
    if item.id > len(tokens.groups):
        old = int(row_ids(scene)[chosen].max()) if chosen.any() else 0
        token = tokens.groups[old - 1] if old else tokens.groups.new_zeros(tokens.groups.shape[1])
        tokens = with_group(tokens, token)
        known = semantics.with_group_like(scene.semantics, old - 1 if old else None)
        scene = replace(scene, semantics=known)
    num_anchors = len(tokens.positions)
    going = torch.zeros(num_anchors, dtype=torch.bool)
    staying = going.clone()
    going[index[chosen]], staying[index[~chosen]] = True, True
    # 1. Copies of the anchors of which only some Gaussians go.
    copied = (going & staying).nonzero()[:, 0]
    new_index = torch.arange(num_anchors)
    new_index[copied] = num_anchors + torch.arange(len(copied))
    tokens = SceneTokens(
        torch.cat([tokens.positions, tokens.positions[copied]]),
        torch.cat([tokens.anchors, tokens.anchors[copied]]),
        tokens.groups,
        torch.cat([tokens.assignment, tokens.assignment[copied]]),
    )
    index_of_row = torch.cat([torch.arange(num_anchors), copied])
    scene = replace(scene, semantics=semantics.with_anchors(scene.semantics, index_of_row))
    # 2. Rows of the anchors that go.
    rows = new_index[going.nonzero()[:, 0]]
    pi = tokens.assignment.clone()
    before, column = pi[rows].argmax(dim=1), item.id - 1
    share = torch.where(before == column, 0, pi[rows, before])
    pi[rows, before] -= share
    pi[rows, column] += share
    index = torch.where(chosen, new_index[index], index)
    # 3. Gaussians sorted by object again.
    ids = row_ids(scene)
    changed = {number for number in ids[chosen].unique().tolist() if number} | {item.id}
    ids = torch.where(chosen, item.id, ids)
    key = torch.where(ids == 0, len(tokens.groups) + 1, ids)
    order = key.argsort(stable=True)
    gaussians = replace(scene.gaussians, anchor_index=index).rows(order)
    totals = ids.bincount(minlength=len(tokens.groups) + 1).tolist()
    objects = [each for each in scene.objects if each.id != item.id]
    objects = sorted([*objects, item], key=lambda each: each.id)
    counts = {each.id: totals[each.id] for each in objects}
    return rebuilt(scene, gaussians, replace(tokens, assignment=pi), objects, counts, changed)


def rebuilt(
    scene: SceneRecord,
    gaussians: Gaussians,
    tokens: SceneTokens,
    objects: Sequence[SceneObject],
    counts: Mapping[int, int],
    changed: Collection[int],
) -> SceneRecord:
    """The scene with other Gaussians and tokens, its objects described to fit.

    Ranges, counts, boxes and centroids are found at once, where an object is seen when it is first
    asked for (`scene.objects.LateSight`).

    Args:
        scene: Everything else.
        gaussians: Sorted by object in the order of the objects.
        tokens: Theirs.
        objects: By rising id; those without Gaussians are left out.
        counts: Gaussians of each object, by id.
        changed: Ids of objects whose boxes are to be found anew.
    """
    num_anchors = owners(tokens).bincount(minlength=len(tokens.groups) + 1).tolist()
    described, start = [], 0
    for item in objects:
        count = counts[item.id]
        if not count:
            continue
        placed = replace(
            item, num_gaussians=count, gaussian_range=(start, count),
            num_anchors=num_anchors[item.id - 1],
        )  # fmt: skip
        if item.id in changed:
            box, oriented, center = describe_shape(gaussians.rows(slice(start, start + count)))
            placed = replace(placed, aabb=box, obb=oriented, centroid=center)
        described.append(placed)
        start += count
    bare = replace(scene, gaussians=gaussians, tokens=tokens, objects=tuple(described))
    return looked_at_later(bare)
