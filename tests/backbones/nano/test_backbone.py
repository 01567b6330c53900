"""The nano backbone keeps what is given and solves the rest, for any number and size of views."""

import pytest
import torch

from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig, RawGeometry
from instok3d.backbones.nano.bundle_problem import SolveSettings
from instok3d.backbones.nano.matching import find_peaks
from instok3d.backbones.nano.pair_cameras import solve_views
from instok3d.backbones.nano.pair_matches import PhotoViews
from instok3d.geometry.cameras import intrinsics_from_field_of_view
from instok3d.geometry.registration import rigid_from_twist
from instok3d.types import Views

TINY = NanoConfig(width=64, layers=1, match_channels=16, refinement_layers=0)


@pytest.fixture(scope="module")
def backbone() -> NanoBackbone:
    torch.manual_seed(0)
    return NanoBackbone(TINY).eval()


def photos(rng: torch.Generator, views: int, height: int = 32, width: int = 32) -> torch.Tensor:
    return torch.rand(2, views, 3, height, width, generator=rng)


@pytest.mark.parametrize(("views", "height", "width"), [(1, 32, 32), (2, 32, 48), (5, 40, 24)])
def test_any_number_and_size_of_views(backbone, rng, views, height, width):
    with torch.no_grad():
        geometry = backbone(Views(photos(rng, views, height, width)))
    assert geometry.features.shape == (2, views, height * width // 64, 128)
    assert geometry.pointmaps.shape == (2, views, height, width, 3)
    assert (geometry.depths > 0).all()
    assert geometry.pointmaps.isfinite().all()
    first = geometry.cameras.cam_from_world[:, 0]
    torch.testing.assert_close(first, torch.eye(4).expand(2, 4, 4))


def test_size_that_is_no_multiple_of_the_patch_is_an_error(backbone, rng):
    with pytest.raises(ValueError, match=r"30x32 pixels.*multiples of 8"):
        backbone(Views(photos(rng, 1, height=30)))


def test_given_depth_and_cameras_come_back_unchanged(backbone, rng):
    cameras = rigid_from_twist(0.2 * torch.randn(2, 3, 6, generator=rng))
    depths = 1 + torch.rand(2, 3, 32, 32, generator=rng)
    intrinsics = intrinsics_from_field_of_view(torch.tensor(1.0), 32, 32).expand(2, 3, 3, 3)
    with torch.no_grad():
        geometry = backbone(Views(photos(rng, 3), intrinsics, cameras, depths))
    torch.testing.assert_close(geometry.depths, depths)
    torch.testing.assert_close(geometry.cameras.intrinsics, intrinsics)
    one_from_first = cameras[:, 1] @ cameras[:, 0].inverse()
    torch.testing.assert_close(
        geometry.cameras.cam_from_world[:, 1], one_from_first, atol=1e-5, rtol=1e-5
    )


def test_holes_in_given_depth_are_filled_at_its_scale(backbone, rng):
    depths = 7 + torch.rand(2, 1, 32, 32, generator=rng)
    depths[:, :, :16] = 0
    with torch.no_grad():
        geometry = backbone(Views(photos(rng, 1), depths=depths))
    torch.testing.assert_close(geometry.depths[:, :, 16:], depths[:, :, 16:])
    filled = geometry.depths[:, :, :16].median()
    assert 5 < float(filled) < 11


@pytest.mark.parametrize(("distance", "free"), [(1.0, 1.0), (1.0, 0.0), (5.0, 0.0)])
def test_descriptors_that_agree_only_along_a_shift_give_that_shift(backbone, distance, free):
    # Two flat walls some units away; every cell of view 1 shows what view 0 shows one cell (four
    # pixels) to its right, so the camera moved by 4 pixels / 32 pixels of focal length, times
    # the distance.
    cells = 8
    codes = torch.eye(cells * (cells + 1)).view(cells, cells + 1, -1)
    descriptors = torch.stack([codes[:, :-1].flatten(0, 1), codes[:, 1:].flatten(0, 1)])[None]
    raw = RawGeometry(
        features=torch.zeros(1, 2, 16, 1),
        log_depths=torch.zeros(1, 2, 32, 32),
        log_confidences=torch.zeros(1, 2, 32, 32),
        descriptors=descriptors,
        log_focal=torch.zeros(1, 2),
        quarter=torch.zeros(2, 64, 8, 8),
    )
    intrinsics = torch.tensor([[32.0, 0, 16], [0, 32.0, 16], [0, 0, 1]]).expand(1, 2, 3, 3)
    matches = backbone.find_matches(raw)
    walls = torch.full((1, 2, 32, 32), distance)
    # The photos show nothing: the matches stay where the descriptors put them.
    views = PhotoViews(torch.zeros(1, 2, 3, 32, 32), walls, intrinsics)
    solved = solve_views(matches, views, SolveSettings(torch.full((1, 2), free)))
    expected = torch.eye(4)
    expected[0, 3] = -4 / 32 * distance
    found = solved.cam_from_first[0, 1]
    torch.testing.assert_close(found, expected, atol=2e-2 * distance, rtol=0)
    assert solved.log_depth_correction.abs().max() < (0.05 if free else 1e-3)


@pytest.mark.parametrize(("views", "count"), [(1, 0), (2, 1), (4, 6), (6, 11)])
def test_pairs_are_a_tree_and_at_most_as_many_more_as_views(backbone, rng, views, count):
    with torch.no_grad():
        raw = backbone.encode(Views(photos(rng, views)))
    matches = backbone.find_matches(raw)
    assert len(matches) == count
    for scene in range(2):
        pairs = {
            frozenset((int(pair.views_a[scene]), int(pair.views_b[scene]))) for pair in matches
        }
        assert len(pairs) == count
        linked = {0}
        for _ in range(views):
            linked |= {view for pair in pairs if pair & linked for view in pair}
        assert linked == set(range(views))


def test_known_depth_without_cameras_stays_as_it_is(backbone, rng):
    depths = 5 + torch.rand(2, 2, 32, 32, generator=rng)
    with torch.no_grad():
        geometry = backbone(Views(photos(rng, 2), depths=depths))
    torch.testing.assert_close(geometry.depths, depths)
    assert geometry.cameras.cam_from_world.isfinite().all()


def test_peak_lies_between_its_cells_and_ignores_far_ones():
    # A row of 9 cells: 0.3 and 0.3 at cells 2 and 3, 0.25 far away at cell 8, 0.15 not seen.
    probability = torch.full((1, 1, 9), 1e-9)
    probability[..., 2], probability[..., 3], probability[..., 8] = 0.3001, 0.3, 0.25
    peak = find_peaks(probability.log(), torch.zeros(1, 1), columns=9)
    # Their centres lie at 4 * 2 + 2 and 4 * 3 + 2 pixels.
    torch.testing.assert_close(peak.pixels, torch.tensor([[[12.0, 2.0]]]), atol=4e-3, rtol=0)
    torch.testing.assert_close(peak.centers, torch.tensor([[2.0, 2.0]]))
    torch.testing.assert_close(peak.confidence, torch.tensor([[0.6001]]))


def test_window_at_a_corner_stays_inside():
    peak = find_peaks(torch.zeros(1, 4, 4), torch.full((1, 4), 4.0).log(), columns=2)
    # All four cells of the 2x2 image are in every window, none counted twice.
    torch.testing.assert_close(peak.confidence, torch.ones(1, 4))


def test_match_probabilities_leave_room_for_not_seen(backbone, rng):
    codes = torch.nn.functional.normalize(torch.randn(1, 12, 16, generator=rng), dim=-1)
    logits, total = backbone.match(codes, codes)
    seen = (logits - total[..., None]).exp().sum(-1)
    unseen = (backbone.no_match() - total).exp()
    torch.testing.assert_close(seen + unseen, torch.ones(1, 12))


def test_photos_alone_reach_every_parameter_but_the_ray_embedding(rng):
    torch.manual_seed(0)
    backbone = NanoBackbone(TINY)
    raw = backbone.encode(Views(photos(rng, 2)))
    logits, total = backbone.match(raw.descriptors[:, 0], raw.descriptors[:, 1])
    matches = (logits - total[..., None]).square().sum()
    depth = raw.log_depths.square().sum() + raw.log_confidences.sum()
    (matches + depth + (raw.log_focal - 1).square().sum()).backward()
    silent = {name for name, p in backbone.named_parameters() if p.grad is None}
    assert silent == {"embed_ray.weight", "embed_ray.bias"}
