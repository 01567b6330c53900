"""Cameras by pycolmap: from exact points, and from photos of a patterned room by SIFT."""

from pathlib import Path

import pytest
import torch

from instok3d.geometry.cameras import invert_rigid, project, transform_points
from instok3d.geometry.rotations import angle_between_rad
from instok3d.photos.pixel_map import fit_pixels
from instok3d.sfm import colmap
from instok3d.sfm.colmap import RegisteredPhoto, register_photos
from instok3d.sfm.matches import Keypoints, PhotoMatches, match_photos
from textured_room import HEIGHT, INTRINSICS, WIDTH, cameras, save_photos

pytest.importorskip("pycolmap", reason="pycolmap is not installed")


def made_matches(
    count: int, rng: torch.Generator, *, odd: int | None = None, focal: float | None = None
) -> PhotoMatches:
    """Of points in the room, seen with an error of a third of a pixel; one photo matches none."""
    points = 4 * torch.rand(400, 3, generator=rng).double() - torch.tensor([2.0, 2.0, -2.0])
    found = []
    for camera in cameras(count):
        pixels = project(transform_points(camera, points), INTRINSICS)
        pixels = pixels + torch.randn(pixels.shape, generator=rng) / 3
        pixel_map = fit_pixels(HEIGHT, WIDTH, HEIGHT, WIDTH)
        found.append(Keypoints(pixels.float(), torch.ones(len(points), 1), pixel_map, focal))
    rows = torch.arange(len(points))[:, None].expand(-1, 2)
    shuffled = torch.stack([rows[:40, 0], torch.randperm(40, generator=rng)], dim=1)
    pairs = {
        (a, b): shuffled if odd in (a, b) else rows
        for a in range(count)
        for b in range(a + 1, count)
    }
    return PhotoMatches(tuple(found), pairs, "made")


def rotation_errors_deg(registered: list[RegisteredPhoto]) -> torch.Tensor:
    """Of the registered photos against the first of them, so that the worlds do not matter."""
    true = cameras()[[each.number for each in registered]][:, :3, :3]
    own = torch.stack([each.cam_from_world for each in registered])[:, :3, :3]
    relative = [matrices[1:] @ matrices[:1].mT for matrices in (own, true)]
    return angle_between_rad(*relative).rad2deg()


def test_cameras_and_depths_of_exact_points(rng: torch.Generator):
    registered = register_photos(made_matches(8, rng))
    assert [each.number for each in registered] == list(range(8))
    assert float(rotation_errors_deg(registered).max()) < 0.5
    for each in registered:
        assert float(each.intrinsics[0, 0] / INTRINSICS[0, 0]) == pytest.approx(1, abs=0.03)
        assert each.intrinsics[:2, 2].tolist() == [WIDTH / 2, HEIGHT / 2]
        assert len(each.pixels) == len(each.depths) > 300
        assert (each.depths > 0).all()


def test_the_same_matches_give_the_same_bits(rng: torch.Generator):
    matches = made_matches(4, rng)
    first, again = register_photos(matches), register_photos(matches)
    for one, other in zip(first, again, strict=True):
        assert torch.equal(one.cam_from_world, other.cam_from_world)
        assert torch.equal(one.depths, other.depths)


def test_a_photo_that_matches_no_other_is_not_registered(rng: torch.Generator):
    registered = register_photos(made_matches(6, rng, odd=2))
    assert [each.number for each in registered] == [0, 1, 3, 4, 5]


def test_a_wrong_focal_length_in_exif_is_corrected(rng: torch.Generator):
    registered = register_photos(made_matches(8, rng, focal=1.3 * float(INTRINSICS[0, 0])))
    assert len(registered) == 8
    assert float(registered[0].intrinsics[0, 0] / INTRINSICS[0, 0]) == pytest.approx(1, abs=0.05)


def test_without_matches_nothing_is_registered(rng: torch.Generator):
    matches = made_matches(3, rng)
    none = PhotoMatches(matches.keypoints, {}, "made")
    assert register_photos(none) == []
    few = {pair: rows[:10] for pair, rows in matches.pairs.items()}
    assert register_photos(PhotoMatches(matches.keypoints, few, "made")) == []


def test_photos_of_a_patterned_room_are_registered_by_sift(tmp_path: Path):
    from instok3d.sfm.sift import Sift

    registered = register_photos(match_photos(save_photos(tmp_path / "photos"), Sift()))
    assert [each.number for each in registered] == list(range(8))
    assert float(rotation_errors_deg(registered).max()) < 2
    centres = invert_rigid(torch.stack([each.cam_from_world for each in registered]))[:, :3, 3]
    true = invert_rigid(cameras())[:, :3, 3]
    steps, true_steps = ((path[1:] - path[:-1]).norm(dim=1) for path in (centres, true))
    torch.testing.assert_close(
        steps / steps.sum(), true_steps / true_steps.sum(), atol=0.02, rtol=0
    )


def test_without_pycolmap_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "pycolmap", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'instok3d\[sfm\]'"):
        colmap.pycolmap_module()
