import torch

from fake_rooms import FakeRooms
from instok3d.data.batches import BatchConfig, SceneBatches
from instok3d.data.mirror import mirror_sample
from instok3d.data.sample import Sample
from instok3d.geometry.cameras import invert_rigid, project, transform_points, unproject


def plain(**settings) -> Sample:
    config = BatchConfig(2, photometric=False, **settings)
    return SceneBatches(FakeRooms(3, size=32), range(3), config, seed=0).batch(0)


def test_a_mirrored_point_of_the_first_view_is_seen_mirrored_in_the_second():
    sample = plain()
    mirrored = mirror_sample(sample)
    seen = []
    for views in (sample.context, mirrored.context):
        points = unproject(views.depths, views.intrinsics)[:, 0].flatten(1, 2)
        second = views.cam_from_world[:, 1] @ invert_rigid(views.cam_from_world[:, 0])
        pixels = project(transform_points(second, points), views.intrinsics[:, 1])
        seen.append(pixels.unflatten(1, (32, 32)))
    expected = seen[0].flip(2)
    expected = torch.stack([32 - expected[..., 0], expected[..., 1]], dim=-1)
    torch.testing.assert_close(seen[1], expected, atol=1e-3, rtol=1e-4)


def test_mirrored_twice_is_the_sample_and_cameras_stay_rigid():
    sample = plain()
    mirrored = mirror_sample(sample)
    rotations = mirrored.target.cam_from_world[..., :3, :3]
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(2, 2))
    torch.testing.assert_close(mirrored.context.cam_from_world[:, 0], torch.eye(4).expand(2, 4, 4))
    assert torch.equal(mirrored.target_instances, sample.target_instances.flip(-1))
    twice = mirror_sample(mirrored)
    for part in ("context", "target"):
        for name, value in vars(getattr(sample, part)).items():
            torch.testing.assert_close(getattr(getattr(twice, part), name), value)


def test_bare_photos_are_mirrored_too():
    sample = plain()
    bare = Sample(
        context=type(sample.context)(sample.context.images),
        target=type(sample.target)(sample.target.images),
        context_instances=sample.context_instances,
        target_instances=sample.target_instances,
        names=sample.names,
    )
    mirrored = mirror_sample(bare)
    assert mirrored.context.cam_from_world is None
    assert torch.equal(mirrored.context.images, bare.context.images.flip(-1))


def test_about_half_of_the_samples_are_mirrored_where_it_is_asked_for():
    config = BatchConfig(4, photometric=False, mirror=True)
    batches = SceneBatches(FakeRooms(3, size=32), range(3), config, seed=0)
    names = [name for step in range(10) for name in batches.batch(step).names]
    assert 10 < sum(name.endswith("mirrored") for name in names) < 30
    straight = SceneBatches(
        FakeRooms(3, size=32), range(3), BatchConfig(4, photometric=False), seed=0
    )
    same = [name for step in range(10) for name in straight.batch(step).names]
    assert [name.removesuffix(" mirrored") for name in names] == same
