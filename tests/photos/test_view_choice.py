import pytest
import torch

from instok3d.photos.view_choice import choose_views, describe_cameras, describe_pictures


def test_choice_on_a_line_by_hand():
    # From 0 the farthest is 10; then 4 is 4 away from both sides' nearest, 5 is 5, 9 is 1.
    descriptors = torch.tensor([[0.0], [4.0], [10.0], [5.0], [9.0]])
    assert choose_views(descriptors, 1) == [0]
    assert choose_views(descriptors, 2) == [0, 2]
    assert choose_views(descriptors, 3) == [0, 2, 3]


def test_the_first_view_stays_and_the_order_is_kept(rng):
    chosen = choose_views(torch.randn(40, 6, generator=rng), 12)
    assert chosen[0] == 0
    assert chosen == sorted(set(chosen))
    assert len(chosen) == 12


def test_copies_come_last(rng):
    different = torch.randn(4, 3, generator=rng)
    descriptors = different[[0, 0, 0, 1, 1, 2, 3, 3]]
    assert choose_views(descriptors, 4) == [0, 3, 5, 6]
    assert choose_views(descriptors, 5) == [0, 1, 3, 5, 6]


def test_as_many_as_there_are_or_more_is_all_of_them():
    assert choose_views(torch.zeros(3, 2), 3) == [0, 1, 2]
    assert choose_views(torch.zeros(3, 2), 7) == [0, 1, 2]


def test_no_view_and_a_non_finite_descriptor_are_errors():
    with pytest.raises(ValueError, match="at least one view"):
        choose_views(torch.zeros(3, 2), 0)
    with pytest.raises(ValueError, match="finite"):
        choose_views(torch.full((3, 2), torch.nan), 2)


def test_exposure_counts_less_than_content(rng):
    picture = torch.rand(3, 16, 16, generator=rng)
    darker = 0.6 * picture
    other = torch.rand(3, 16, 16, generator=rng)
    descriptors = describe_pictures(torch.stack([picture, darker, other]))
    distance = (descriptors - descriptors[0]).norm(dim=1)
    assert distance[1] < 0.3 * distance[2]


def test_pictures_of_one_colour_have_finite_descriptors():
    assert describe_pictures(torch.ones(2, 3, 16, 16)).isfinite().all()


def test_cameras_are_described_by_place_and_direction_by_hand():
    # Camera 0 at (-3, 0, 0), camera 1 at (3, 0, 0) looking along -z: spread 3.
    first = torch.eye(4)
    first[0, 3] = 3.0  # cam_from_world: minus the centre
    second = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0]))
    second[0, 3] = 3.0
    expected = torch.tensor([[-1.0, 0, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, -1]])
    torch.testing.assert_close(describe_cameras(torch.stack([first, second])), expected)


def test_one_camera_is_described():
    torch.testing.assert_close(
        describe_cameras(torch.eye(4)[None]), torch.tensor([[0.0, 0, 0, 0, 0, 1]])
    )
