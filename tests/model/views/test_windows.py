from dataclasses import replace

import pytest
import torch

from instok3d.geometry.cameras import transform_points
from instok3d.model.context import to_patches
from instok3d.model.gaussian_head import GaussianHeadConfig
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.model.views.joining import WindowGroups, collate_scenes, join_groups, join_windows
from instok3d.model.views.windows import cut_window, middle_windows, view_windows, window_lengths
from instok3d.types import Geometry, TokenGroups, Views
from plane_backbone import PlaneBackbone, PlaneConfig

PATCHES = 16  # of a view of 32 x 32 pixels
SMALL = TokenizerConfig(
    width=32,
    num_anchors=64,
    num_groups=6,
    window_views=4,
    anchor_layers=1,
    group_layers=1,
    head_size=16,
    gaussian_head=GaussianHeadConfig(gaussians_per_anchor=4),
)


def small_tokenizer(**changes) -> Tokenizer:
    torch.manual_seed(0)
    return Tokenizer(PlaneBackbone(PlaneConfig()), replace(SMALL, **changes))


def photos(rng: torch.Generator, *, batch: int = 1, views: int = 8) -> Views:
    return Views(torch.rand(batch, views, 3, 32, 32, generator=rng))


def windows_of(rng: torch.Generator, views: int, size: int) -> list[list[int]]:
    geometry = small_tokenizer().backbone(photos(rng, views=views))
    farther = 0.6 * torch.arange(views)
    geometry.cameras.cam_from_world[..., 0, 3] -= farther
    geometry.pointmaps[..., 0] += farther[:, None, None]
    return view_windows(geometry, 0, size)


def test_windows_go_along_the_path_one_view_at_a_time_and_come_again_turned_round(rng):
    # The cameras stand 0.7 apart in the order of their numbers.
    fours, pairs = [[0, 1, 2, 3], [1, 2, 3, 4]], [[0, 1], [1, 2], [2, 3], [3, 4]]
    back = [[3, 2, 1, 0], [4, 3, 2, 1], [1, 0], [2, 1], [3, 2], [4, 3]]
    assert windows_of(rng, 5, 4) == fours + pairs + back
    there, back = [[0, 1], [1, 2], [2, 3]], [[1, 0], [2, 1], [3, 2]]
    assert windows_of(rng, 4, 2) == there + back
    assert windows_of(rng, 4, 4) == [[0, 1, 2, 3]]
    assert windows_of(rng, 3, 4) == [[0, 1, 2]]


@pytest.mark.parametrize("views", [1, 4, 5, 6, 8, 16])
def test_windows_have_the_lengths_that_are_said(rng, views):
    for size in (2, 4):
        found = [len(window) for window in windows_of(rng, views, size)]
        assert found == window_lengths(views, size)


def test_a_window_is_the_same_world_from_its_own_first_camera(rng):
    views = photos(rng, batch=2, views=6)
    geometry = small_tokenizer().backbone(views)
    cut, seen = cut_window(views, geometry, 1, [3, 1, 4])
    assert torch.equal(cut.images[0], views.images[1, [3, 1, 4]])
    torch.testing.assert_close(seen.cameras.cam_from_world[0, 0], torch.eye(4))
    moved = transform_points(
        geometry.cameras.cam_from_world[1, 3], geometry.pointmaps[1, 4].flatten(0, 1)
    )
    torch.testing.assert_close(seen.pointmaps[0, 2].flatten(0, 1), moved)


def window_groups(patches: list[int], held: list[list[float]]) -> WindowGroups:
    rows = torch.tensor(held).view(len(held), len(patches))
    return WindowGroups(rows, torch.tensor(patches), torch.zeros(len(held), 1))


def numbers(windows: list[WindowGroups], num_patches: int) -> list[list[int]]:
    return [owner.tolist() for owner in join_groups(windows, num_patches)]


def test_groups_are_joined_by_hand():
    # The windows share patches 2 and 3.
    # Group 0 {0, 1, 2} and group 0' {2, 4}: on shared patches both have 2 alone, IoU 1.
    # Group 1 {3} and .9 of 3: IoU .9. Group 2' has .1 of patch 3: IoU .1 / 1, below .15.
    first = window_groups([0, 1, 2, 3], [[1.0, 1, 1, 0], [0, 0, 0, 1]])
    second = window_groups([2, 3, 4, 5], [[1.0, 0, 1, 0], [0, 0.9, 0, 1], [0, 0.1, 0, 0]])
    assert numbers([first, second], 6) == [[0, 1], [0, 1, 2]]
    # In whatever order a window names its patches.
    turned = WindowGroups(second.held.flip(1), second.patches.flip(0), second.tokens)
    assert numbers([first, turned], 6) == [[0, 1], [0, 1, 2]]
    assert numbers([turned, first], 6) == [[0, 1, 2], [0, 1]]


def test_windows_that_share_no_patch_share_no_group():
    one, other = window_groups([0, 1], [[1.0, 1]]), window_groups([2, 3], [[1.0, 1]])
    assert numbers([one, other], 4) == [[0], [1]]


def test_two_groups_of_one_window_are_never_joined_by_way_of_another():
    # The group of window 1 overlaps both of window 0; it goes to the likelier one.
    two = window_groups([0, 1, 2], [[0.4, 0.4, 0], [0.6, 0.6, 1]])
    one = window_groups([0, 1, 2], [[1.0, 1, 1]])
    assert numbers([two, one], 3) == [[0, 1], [1]]
    assert numbers([window_groups([0, 1], []), window_groups([1, 2], [])], 3) == [[], []]


def test_only_windows_whose_gaussians_stay_decode_them(rng):
    model, shown = small_tokenizer(), photos(rng, views=6)
    geometry = model.backbone(shown)
    windows = view_windows(geometry, 0, 4)
    decoded = []
    model.gaussian_head.register_forward_hook(lambda *_: decoded.append(1))
    found = model(shown, geometry)
    assert len(decoded) == len(set(middle_windows(windows).values())) < len(windows)
    parts = [model.tokenize(*cut_window(shown, geometry, 0, window)) for window in windows]
    whole = join_windows(parts, windows, geometry, 0)
    assert torch.equal(found.assignment, whole.assignment)
    assert torch.equal(found.gaussians.means, whole.gaussians.means)
    assert torch.equal(found.gaussians.sh, whole.gaussians.sh)


def test_up_to_the_size_of_a_window_nothing_is_cut(rng):
    model, views = small_tokenizer(), photos(rng, views=4)
    found, whole = model(views), model.tokenize(views, model.backbone(views))
    assert torch.equal(found.assignment, whole.assignment)
    assert torch.equal(found.gaussians.means, whole.gaussians.means)


@pytest.mark.parametrize("views", [5, 8])
def test_every_patch_has_one_anchor_where_it_lies_in_the_world(rng, views):
    model, shown = small_tokenizer(), photos(rng, views=views)
    groups = model(shown)
    patches = groups.anchors.patches[0]
    assert sorted(patches.tolist()) == list(range(PATCHES * views))
    centers = to_patches(groups.geometry.pointmaps, 8)[0, :, 4, 4]
    torch.testing.assert_close(groups.anchors.positions[0], centers[patches], atol=1e-5, rtol=0)
    torch.testing.assert_close(groups.assignment.sum(-1), torch.ones(1, PATCHES * views))
    index = groups.gaussians.anchor_index[0]
    assert index.bincount().tolist() == [4] * PATCHES * views
    # Gaussians start on their anchor's patch and move by cells: they are near their anchors.
    away = (groups.gaussians.means[0] - groups.anchors.positions[0, index]).norm(dim=-1)
    assert away.max() < 3


def made_part(window: list[int], ids: torch.Tensor, names: list[int]) -> TokenGroups:
    """A window whose group g holds exactly the patches with the id names[g]."""
    model = small_tokenizer(num_groups=len(names))
    shown = photos(torch.Generator().manual_seed(0))
    geometry = model.backbone(shown)
    part = model.tokenize(*cut_window(shown, geometry, 0, window))
    own = ids[torch.tensor(window)].flatten()
    columns = [*((own == name).float() for name in names)]
    void = 1 - torch.stack(columns).sum(dim=0)
    return replace(
        part,
        assignment=torch.stack([*columns, void], dim=1)[None],
        tokens=torch.tensor(names, dtype=torch.float)[:, None].expand(-1, 32)[None],
    )


def test_objects_that_windows_know_by_other_numbers_are_whole_again(rng):
    ids = torch.zeros(8, PATCHES, dtype=torch.long)
    ids[:, :6], ids[:5, 6:9], ids[4:, 6:9], ids[2:, 12:] = 1, 2, 3, 4
    windows = [[0, 1, 2, 3], [2, 3, 4, 5], [4, 5, 6, 7]]
    names = [[4, 2, 1, 9], [1, 2, 3, 4], [3, 1, 4]]
    parts = [made_part(w, ids, n) for w, n in zip(windows, names, strict=True)]
    geometry: Geometry = small_tokenizer().backbone(photos(rng))
    scene = join_windows(parts, windows, geometry, 0)
    true = ids.flatten()[scene.anchors.patches[0]]
    assert scene.tokens.shape == (1, 4, 32)  # 9 held nothing and is gone
    for number in range(4):
        name = int(scene.tokens[0, number, 0])  # the mean of tokens that are all alike
        torch.testing.assert_close(scene.assignment[0, :, number], (true == name).float())
    torch.testing.assert_close(scene.assignment[0, :, -1], (true == 0).float())


def test_a_scene_of_void_alone_has_no_groups(rng):
    ids = torch.zeros(8, PATCHES, dtype=torch.long)
    windows = [[0, 1, 2, 3], [2, 3, 4, 5], [4, 5, 6, 7]]
    parts = [made_part(window, ids, [1, 2]) for window in windows]
    scene = join_windows(parts, windows, small_tokenizer().backbone(photos(rng)), 0)
    assert scene.tokens.shape == (1, 0, 32)
    assert torch.equal(scene.assignment, torch.ones(1, 8 * PATCHES, 1))


def test_a_batch_is_its_scenes_with_empty_groups_behind(rng):
    model, shown = small_tokenizer(), photos(rng, batch=3)
    batch = model(shown)
    for scene in range(3):
        alone = model(Views(shown.images[scene : scene + 1]))
        count = alone.tokens.shape[1]
        torch.testing.assert_close(batch.tokens[scene, :count], alone.tokens[0])
        torch.testing.assert_close(
            batch.assignment[scene, :, :count], alone.assignment[0, :, :-1], atol=1e-5, rtol=1e-4
        )
        assert batch.assignment[scene, :, count:-1].abs().max() == 0 if count < 6 else True
        torch.testing.assert_close(
            batch.gaussians.means[scene], alone.gaussians.means[0], atol=1e-5, rtol=1e-4
        )


def test_scenes_with_different_numbers_of_anchors_are_no_batch(rng):
    model = small_tokenizer()
    scenes = [model(photos(rng, views=views)) for views in (5, 6)]
    with pytest.raises(ValueError, match="different numbers of anchors, 80 to 96"):
        collate_scenes(scenes, scenes[0].geometry)


def test_narrow_numbers_reach_neither_places_nor_shares(rng):
    model, views = small_tokenizer(), photos(rng)
    geometry = model.backbone(views)
    exact = model(views, geometry)
    with torch.autocast("cpu", torch.bfloat16):
        narrow = model(views, geometry)
    torch.testing.assert_close(narrow.anchors.positions, exact.anchors.positions)
    sums = narrow.assignment.sum(-1)
    torch.testing.assert_close(sums, torch.ones_like(sums), atol=1e-6, rtol=0)


def test_gradients_go_through_the_joining(rng):
    model = small_tokenizer()
    groups = model(photos(rng))
    weights = torch.rand(groups.assignment.shape, generator=rng)
    ((groups.assignment * weights).sum() + groups.gaussians.means.square().sum()).backward()
    for name in ("group_decoder.queries", "assign.anchor_proj.0.weight", "gaussian_head.out.bias"):
        gradient = model.get_parameter(name).grad
        assert gradient is not None
        assert gradient.isfinite().all()
        assert gradient.abs().max() > 0
