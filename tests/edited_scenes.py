"""What must hold of any scene, whatever was edited; and edits drawn at random."""

import random
from collections.abc import Callable

import torch

from instok3d.scene.boxes import describe_shape
from instok3d.scene.edits.history import as_record
from instok3d.scene.edits.ownership import owners, row_ids
from instok3d.scene.record import SceneRecord
from instok3d.scene.scene import Scene
from instok3d.scene.sight import look
from instok3d.types import check_gaussians


def tensors_of(scene: SceneRecord) -> list[torch.Tensor]:
    """Every tensor of a scene."""
    stages = (scene.gaussians, scene.tokens, scene.cameras, *scene.semantics.values())
    return [value for stage in stages for value in vars(stage).values()] + [scene.photos]


def assert_bit_equal(first: SceneRecord, second: SceneRecord) -> None:
    """All tensors byte by byte, objects and everything else by value."""
    for one, other in zip(tensors_of(first), tensors_of(second), strict=True):
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        assert one.numpy().tobytes() == other.numpy().tobytes()
    assert first.objects == second.objects
    assert first.provenance == second.provenance
    assert (first.views, first.near_far) == (second.views, second.near_far)


def assert_consistent(scene: SceneRecord, *, sight: bool = False) -> None:
    """Ranges, ids, owners, counts, boxes and, where asked for, where objects are seen."""
    check_gaussians(scene.gaussians, "the scene")
    tokens, num_groups = scene.tokens, len(scene.tokens.groups)
    assert len(tokens.positions) == len(tokens.anchors) == len(tokens.assignment)
    assert tokens.assignment.shape[1] == num_groups + 1
    assert float((tokens.assignment.sum(1) - 1).abs().max().nan_to_num()) < 1e-4
    for one in scene.semantics.values():
        assert len(one.shared) == num_groups
        assert len(one.residuals) == len(one.mixing) == len(tokens.positions)
        assert float((one.mixing.sum(1) - 1).abs().max().nan_to_num()) < 1e-3
    ids = [item.id for item in scene.objects]
    assert ids == sorted(set(ids))
    assert len({item.key for item in scene.objects}) == len(ids)
    assert all(1 <= number <= num_groups for number in ids)
    owner = owners(tokens)
    assert not len(owner) or int(scene.gaussians.anchor_index.max().item() if len(
        scene.gaussians.anchor_index) else 0) < len(owner)  # fmt: skip
    owned = owner[scene.gaussians.anchor_index] + 1
    rows = row_ids(scene)
    assert torch.equal(owned[rows > 0], rows[rows > 0])
    assert not torch.isin(owned[rows == 0], torch.tensor(ids, dtype=torch.long)).any()
    start = 0
    for item in scene.objects:
        assert item.gaussian_range == (start, item.num_gaussians)
        assert item.num_gaussians > 0
        assert item.num_anchors == int((owner == item.id - 1).sum()) > 0
        own = scene.gaussians.rows(slice(start, start + item.num_gaussians))
        assert (item.aabb, item.obb, item.centroid) == describe_shape(own)
        start += item.num_gaussians
    if sight:
        found = look(scene)
        for item in scene.objects:
            assert item.sight == found.of_group(item.id - 1)


def random_edit(scene: Scene, source: Scene, draw: random.Random) -> Scene:
    """One edit drawn at random; the same draw gives the same edit of the same scene."""
    ids = [item.id for item in scene.objects]
    if not ids:
        return scene.insert(source, source.objects[0].id, (0.1, 0.2, 2.0), scale=1.0)
    which = draw.choice(ids)
    by = [draw.uniform(-0.3, 0.3) for _ in range(3)]
    choices: dict[str, Callable[[], Scene]] = {
        "move": lambda: scene.move(which, by, yaw=draw.uniform(-180, 180),
                                   scale=draw.uniform(0.8, 1.25)),
        "shift": lambda: scene.move(which, by),
        "tilt": lambda: scene.move(which, yaw=40, axis=by, about=(0, 0, 2)),
        "recolor": lambda: scene.recolor(which, [draw.random() for _ in range(3)]),
        "rename": lambda: scene.rename(which, draw.choice(["chair", "lamp", "red box"])),
        "hide": lambda: scene.hide(which),
        "show": lambda: scene.show(which),
    }  # fmt: skip
    if len(ids) < 6:
        choices["duplicate"] = lambda: scene.duplicate(which, by, yaw=draw.uniform(0, 90))
        choices["insert"] = lambda: scene.insert(
            source, draw.choice(source.objects).id, by, scale=1.0
        )
        start, count = scene.object(which).gaussian_range
        x = scene.tokens.positions[scene.gaussians.anchor_index[start : start + count], 0]
        middle = float((x.min() + x.max()) / 2)
        if float(x.min()) < middle < float(x.max()):
            choices["split"] = lambda: scene.split(
                which, box=((-1e6, -1e6, -1e6), (middle, 1e6, 1e6))
            )
    if len(ids) > 3:
        choices["remove"] = lambda: scene.remove(which)
        choices["merge"] = lambda: scene.merge(*draw.sample(ids, 2))
        choices["only"] = lambda: scene.only(*draw.sample(ids, 2))
    return choices[draw.choice(sorted(choices))]()


def source_of(scene: Scene) -> SceneRecord:
    """The data of a scene."""
    return as_record(scene)
