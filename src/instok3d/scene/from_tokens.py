"""From what the tokenizer returns to a scene of objects."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, TypeVar

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, transform_points
from instok3d.geometry.moving import move_gaussians
from instok3d.pictures import display_color
from instok3d.scene.boxes import describe_shape
from instok3d.scene.names import key_of
from instok3d.scene.objects import SceneObject
from instok3d.scene.record import Provenance, SceneTokens, SceneView, near_and_far
from instok3d.scene.scene import Scene
from instok3d.scene.sight import MIN_PIXELS, GroupSight, look
from instok3d.scene.vertical import find_vertical
from instok3d.types import Cameras, Gaussians, TokenGroups


@torch.no_grad()
def bare_scene(
    tokens: TokenGroups,
    photos: UInt8[Tensor, "view height width 3"],
    views: Sequence[SceneView],
    *,
    provenance: Provenance,
    cam_from_world: Float[Tensor, "view 4 4"] | None = None,
    units: Literal["metres", "arbitrary"] = "arbitrary",
    notes: Sequence[str] = (),
) -> Scene:
    """The scene of one sample before its objects are looked for; not differentiable.

    Gaussians that are not finite are dropped with a warning, which the scene keeps.

    Args:
        tokens: A batch of one.
        photos: The views as the model saw them.
        views: Where they came from.
        provenance: What the tokens were made with.
        cam_from_world: Given cameras: the scene is moved to their world, in which every view
            then stands exactly where it was given.
        units: Of the tokens' lengths.
        notes: Warnings to be kept with the scene.

    Raises:
        ValueError: A batch of more than one scene, a number of views that does not fit, or
            tokens or cameras that are not finite.
    """
    if tokens.tokens.shape[0] != 1:
        raise ValueError(f"a scene is made of a batch of one, got {tokens.tokens.shape[0]}")
    if not len(photos) == len(views) == tokens.geometry.depths.shape[1]:
        raise ValueError(
            f"{len(views)} views and {len(photos)} photos do not fit tokens of "
            f"{tokens.geometry.depths.shape[1]} views"
        )
    gaussians, dropped = _finite(_first(tokens.gaussians))
    positions = tokens.anchors.positions[0].float()
    cameras = _first(tokens.geometry.cameras)
    if cam_from_world is not None:
        world_from_first = invert_rigid(cam_from_world[0].float())
        gaussians = move_gaussians(gaussians, world_from_first)
        positions = transform_points(world_from_first, positions)
        cameras = Cameras(cam_from_world.float(), cameras.intrinsics)
    compact = SceneTokens(
        positions, tokens.anchors.tokens[0].float(), tokens.tokens[0].float(),
        tokens.assignment[0].float(),
    )  # fmt: skip
    for value in (*vars(compact).values(), *vars(cameras).values()):
        if not value.isfinite().all():
            raise ValueError(
                "the model gave tokens or cameras that are not finite; try another model file"
            )
    frame = "first camera" if cam_from_world is None else "given cameras"
    return Scene(
        gaussians=gaussians, tokens=compact, cameras=cameras,
        height=photos.shape[1], width=photos.shape[2], objects=(), views=tuple(views),
        photos=photos, units=units, frame=frame,
        vertical=find_vertical(cameras.cam_from_world, frame),
        near_far=near_and_far(gaussians, cameras),
        warnings=(*notes, *dropped), provenance=provenance,
    )  # fmt: skip


@torch.no_grad()
def with_objects(scene: Scene) -> Scene:
    """The scene with its objects found anew from the assignment, and its Gaussians sorted.

    See `Scene` for what becomes an object; what is one already stays one, with its key, label
    and colour, while it has Gaussians. Not differentiable.
    """
    sight = look(scene)
    num_groups = scene.tokens.groups.shape[0]
    owner = scene.tokens.assignment.argmax(dim=1)
    num_anchors = owner.bincount(minlength=num_groups + 1)[:num_groups]
    enough = (sight.pixels >= MIN_PIXELS).any(dim=0)
    known = {item.id - 1: item for item in scene.objects}
    enough[list(known)] = True
    chosen = ((num_anchors > 0) & enough).nonzero()[:, 0].tolist()

    rank = torch.full((num_groups + 1,), len(chosen))
    rank[chosen] = torch.arange(len(chosen))
    rank_of_gaussian = rank[owner[scene.gaussians.anchor_index]]
    order = rank_of_gaussian.argsort(stable=True)
    gaussians = scene.gaussians.rows(order)
    counts = rank_of_gaussian.bincount(minlength=len(chosen) + 1)
    starts = counts.cumsum(0) - counts

    objects = []
    for position, group in enumerate(chosen):
        start, count = int(starts[position]), int(counts[position])
        if count:
            own = gaussians.rows(slice(start, start + count))
            found = _describe(own, group, int(num_anchors[group]), sight)
            if group in known:
                old = known[group]
                found = replace(found, key=old.key, label=old.label, color=old.color,
                                label_source=old.label_source, label_score=old.label_score,
                                hidden=old.hidden)  # fmt: skip
            objects.append(replace(found, gaussian_range=(start, count)))
    return replace(scene, gaussians=gaussians, objects=tuple(objects))


def _describe(own: Gaussians, group: int, num_anchors: int, sight: GroupSight) -> SceneObject:
    aabb, obb, centroid = describe_shape(own)
    return SceneObject(
        id=group + 1,
        key=key_of(group + 1, None),
        color=display_color(group + 1),
        aabb=aabb,
        obb=obb,
        centroid=centroid,
        num_anchors=num_anchors,
        num_gaussians=len(own.means),
        gaussian_range=(0, len(own.means)),
        confidence=float(sight.scores[group]),
        sight=sight.of_group(group),
    )


Batched = TypeVar("Batched", Gaussians, Cameras)


def _first(batch: Batched) -> Batched:
    """The one scene of the batch, float32."""
    one = batch.scene(0).map(Tensor.detach)
    return one.map(lambda value: value.float() if value.is_floating_point() else value)


def _finite(gaussians: Gaussians) -> tuple[Gaussians, list[str]]:
    """The Gaussians without those that are not finite, and a warning if there were any."""
    rows = torch.ones(len(gaussians.means), dtype=torch.bool, device=gaussians.means.device)
    for value in vars(gaussians).values():
        rows &= value.isfinite().flatten(1).all(dim=1) if value.ndim > 1 else value.isfinite()
    if rows.all():
        return gaussians, []
    kept = gaussians.rows(rows)
    note = f"dropped {int((~rows).sum())} Gaussians that were not finite"
    warnings.warn(note, stacklevel=3)
    return kept, [note]
