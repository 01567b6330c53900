"""Laws of a rendered scene: cameras, depth, ids and overlap agree; the seed decides all bytes."""

import numpy as np
import pytest

pytest.importorskip("embreex")

from instok3d.rooms.camera_path import OVERLAP
from instok3d.rooms.denoising import find_denoiser
from instok3d.rooms.room import build_room
from instok3d.rooms.scene import RenderedScene, render_scene


@pytest.fixture(scope="module")
def scene() -> RenderedScene:
    found = render_scene(1, resolution=64, denoiser=find_denoiser())
    assert found is not None
    return found


def warped(scene: RenderedScene, source: int, target: int) -> tuple[np.ndarray, ...]:
    """Pixels of `source` that `target` sees as well, as indices into both pictures."""
    size = scene.depths_mm.shape[1]
    depth = scene.depths_mm.astype(np.float64) / 1000
    y, x = np.mgrid[:size, :size] + 0.5
    k = scene.intrinsics[0]
    rays = np.stack([(x - k[0, 2]) / k[0, 0], (y - k[1, 2]) / k[1, 1], np.ones_like(x)], -1)
    a, b = scene.world_from_cam[source], scene.world_from_cam[target]
    world = (rays * depth[source][..., None]).reshape(-1, 3) @ a[:3, :3].T + a[:3, 3]
    local = (world - b[:3, 3]) @ b[:3, :3]
    z = np.maximum(local[:, 2], 1e-3)
    pixel = np.floor(local[:, :2] / z[:, None] * k[0, 0] + size / 2).astype(int)
    inside = (local[:, 2] > 0.05) & (pixel >= 0).all(1) & (pixel < size).all(1)
    px, py = np.where(inside[:, None], pixel, 0).T
    seen = inside & (np.abs(depth[target][py, px] - z) < 0.02 * z + 0.02)
    return np.nonzero(seen)[0], py[seen], px[seen]


@pytest.mark.parametrize("target", [1, 2])
def test_depth_and_cameras_carry_ids_and_colours_to_the_next_view(scene, target):
    index, y, x = warped(scene, 0, target)
    assert len(index) > 0.4 * scene.instances[0].size
    ids = scene.instances[0].reshape(-1)[index]
    assert (ids == scene.instances[target][y, x]).mean() > 0.96
    difference = scene.images[0].reshape(-1, 3)[index] - scene.images[target][y, x].astype(float)
    assert np.abs(difference).mean() < 16


def test_a_wrong_camera_does_not_carry_ids(scene):
    moved = scene.world_from_cam.copy()
    moved[1, :3, 3] += 0.5
    wrong = RenderedScene(**(vars(scene) | {"world_from_cam": moved}))
    assert len(warped(wrong, 0, 1)[0]) < 0.8 * len(warped(scene, 0, 1)[0])


def test_frames_two_apart_overlap_as_promised(scene):
    assert len(scene.meta["overlaps"]) == 14
    assert all(OVERLAP[0] <= o <= OVERLAP[1] for o in scene.meta["overlaps"])


def test_every_pixel_has_an_instance_and_its_count_is_in_the_meta(scene):
    records = {r["id"]: r["pixels"] for r in scene.meta["instances"]}
    for frame, ids in enumerate(scene.instances):
        assert ids.min() > 0
        for instance, count in zip(*np.unique(ids, return_counts=True), strict=True):
            assert records[int(instance)][frame] == count


def test_same_seed_same_bytes(scene):
    again = render_scene(1, resolution=64, denoiser=find_denoiser())
    assert again is not None
    for name in ("images", "instances", "depths_mm", "world_from_cam"):
        assert getattr(again, name).tobytes() == getattr(scene, name).tobytes(), name
    assert again.meta == scene.meta


@pytest.mark.parametrize("seed", [2, 3, 16, 3_000_001])
def test_solid_things_are_inside_the_room_and_apart(seed):
    plan = build_room(seed).plan
    solid = [(key, box) for key, box in plan.obstacles.items() if key > 0]
    for number, (key, box) in enumerate(solid):
        assert (box.corners() > -1e-6).all()
        assert (box.corners() < np.array([plan.width, plan.depth]) + 1e-6).all()
        for other_key, other in solid[number + 1 :]:
            first, second = plan.placed[key - 1], plan.placed[other_key - 1]
            if key != second.parent:  # a pillow lies inside the box of its sofa
                assert not box.overlaps(other), (first.generator, second.generator)


@pytest.mark.parametrize("seed", [2, 3])
def test_parts_stay_in_the_boxes_that_were_kept_free(seed):
    room = build_room(seed)
    for key, box in room.plan.obstacles.items():
        if key < 0:
            continue
        used = np.unique(room.mesh.faces[room.mesh.face_instance == key])
        corners = room.mesh.vertices[used]
        assert max(box.distance(point) for point in corners[:, :2]) < 2e-3
        assert corners[:, 2].min() > box.low - 2e-3
        assert corners[:, 2].max() < box.high + 2e-3
