import torch

from flat_rooms import FlatRooms
from instok3d.baselines.tracking import tracked, unmatched
from instok3d.data.batches import make_sample
from instok3d.data.view_sampling import FrameChoice
from instok3d.types import Cameras

SAMPLE = make_sample(FlatRooms([0], ["easy"]), 0, FrameChoice((5, 7, 9, 11), (8,)))
TRUE = SAMPLE.context_instances[0]


def cameras() -> Cameras:
    context = SAMPLE.context
    assert context.cam_from_world is not None
    assert context.intrinsics is not None
    return Cameras(context.cam_from_world[0], context.intrinsics[0])


def depths() -> torch.Tensor:
    assert SAMPLE.context.depths is not None
    return SAMPLE.context.depths[0]


def shuffled(ids: torch.Tensor) -> torch.Tensor:
    """Other names in every view."""
    tables = torch.tensor([[0, 1, 2, 3], [0, 3, 1, 2], [0, 2, 3, 1], [0, 9, 4, 7]])
    return torch.stack([table[view] for table, view in zip(tables, ids, strict=True)])


def renamed_to(true: torch.Tensor, found: torch.Tensor) -> dict[int, set[int]]:
    return {int(name): set(found[true == name].tolist()) for name in true.unique() if name > 0}


def test_masks_of_one_thing_get_one_id_whatever_their_names():
    found = tracked(shuffled(TRUE), depths(), cameras())
    assert sorted(renamed_to(TRUE, found).values(), key=min) == [{1}, {2}, {3}]
    assert torch.equal(found > 0, TRUE > 0)


def test_half_of_a_mask_is_linked_in_one_view_and_the_rest_stays_alone():
    halved = shuffled(TRUE)
    board = TRUE[1] == 2
    columns = board.nonzero()[:, 1]
    left = board & (torch.arange(32) < columns.float().mean())
    halved[1][left] = 20
    found = tracked(halved, depths(), cameras())
    assert set(found.unique().tolist()) == {1, 2, 3, 4}
    names = renamed_to(TRUE, found)
    assert len(names[2]) == 2
    assert all(len(found[view][TRUE[view] == 2].unique()) == 1 for view in (0, 2, 3))


def test_pixels_without_a_mask_stay_without_one():
    missing = shuffled(TRUE)
    missing[2][TRUE[2] == 3] = 0
    missing[3][0, 0] = -1
    found = tracked(missing, depths(), cameras())
    assert torch.equal(found > 0, missing > 0)
    assert len(renamed_to(TRUE[[0, 1, 3]], found[[0, 1, 3]])[3] - {0}) == 1


def test_wrong_depth_and_no_depth_link_nothing():
    none = tracked(shuffled(TRUE), torch.zeros_like(depths()), cameras())
    assert torch.equal(none, unmatched(shuffled(TRUE)))
    shift = torch.zeros(4, 4, 4)
    shift[:, 0, 3] = torch.arange(4) * 50.0
    apart = Cameras(cameras().cam_from_world + shift, cameras().intrinsics)
    assert len(tracked(shuffled(TRUE), depths(), apart).unique()) == 12


def test_unmatched_masks_are_each_a_thing_of_its_own():
    found = unmatched(torch.tensor([[[4, 0], [9, -1]], [[4, 4], [1, 0]]]))
    assert found.tolist() == [[[1, 0], [2, 0]], [[4, 4], [3, 0]]]
    assert unmatched(torch.zeros(0, 2, 2, dtype=torch.int64)).shape == (0, 2, 2)
    empty = torch.zeros(4, 32, 32, dtype=torch.int64)
    assert not tracked(empty, depths(), cameras()).any()
