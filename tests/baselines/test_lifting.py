import torch

from instok3d.baselines.instances import Instances
from instok3d.baselines.lifting import lifted_labels
from instok3d.types import Cameras, Gaussians

CAMERA = Cameras(torch.eye(4)[None], torch.tensor([[[16.0, 0, 8], [0, 16, 8], [0, 0, 1]]]))


def blobs(*means: list[float]) -> Gaussians:
    count = len(means)
    return Gaussians(
        means=torch.tensor(means).reshape(-1, 3),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        scales=torch.full((count, 3), 0.1),
        opacities=torch.full((count,), 0.9),
        sh=torch.zeros(count, 1, 3),
        anchor_index=torch.arange(count),
    )


def test_a_gaussian_takes_the_labels_of_the_pixels_that_it_shows():
    columns = torch.zeros(1, 16, 16, dtype=torch.int64)
    columns[:, :, 8:] = 1
    instances = Instances(torch.tensor([3, 5]), columns)
    # One on each side, one in the middle, one outside of the picture.
    scene = blobs([-0.25, 0, 1], [0.25, 0, 1], [0, 0.3, 1], [5, 0, 1])
    labels = lifted_labels(scene, CAMERA, instances)
    expected = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0.5, 0.5, 0], [0, 0, 1]])
    torch.testing.assert_close(labels, expected, atol=0.02, rtol=0)


def test_what_is_hidden_counts_as_little_as_it_shows():
    columns = torch.zeros(1, 16, 16, dtype=torch.int64)
    instances = Instances(torch.tensor([3]), columns)
    front, behind = lifted_labels(blobs([0, 0, 1], [0, 0, 1.5]), CAMERA, instances)
    assert front.tolist() == behind.tolist() == [1.0, 0.0]


def test_no_gaussian_has_no_label():
    instances = Instances(torch.tensor([3]), torch.zeros(1, 16, 16, dtype=torch.int64))
    assert lifted_labels(blobs(), CAMERA, instances).shape == (0, 2)
