from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from instok3d.model.context import ContextFusion, to_patches
from instok3d.types import Cameras, Geometry, Views


def scene(pointmaps: torch.Tensor, images: torch.Tensor, *, channels: int = 4):
    batch, views, height, width, _ = pointmaps.shape
    patches = (height // 4) * (width // 4)
    cameras = Cameras(
        torch.eye(4).expand(batch, views, 4, 4), torch.eye(3).expand(batch, views, 3, 3)
    )
    features = torch.linspace(-1, 1, batch * views * patches * channels)
    geometry = Geometry(
        features.view(batch, views, patches, channels).sin(),
        pointmaps[..., 2],
        pointmaps,
        torch.ones_like(pointmaps[..., 0]),
        cameras,
    )
    return Views(images), geometry


def test_patches_are_row_major_views_first():
    # Pixel values = 1000 view + 10 row + column; patches of 2 in images of 4 x 6.
    rows, columns = torch.arange(4)[:, None], torch.arange(6)[None]
    maps = torch.stack([1000 * view + 10 * rows + columns for view in range(2)])[None, ..., None]
    patches = to_patches(maps, 2)[0, ..., 0]
    assert patches.shape == (12, 2, 2)
    assert patches[1].tolist() == [[2, 3], [12, 13]]
    assert patches[3].tolist() == [[20, 21], [30, 31]]
    assert patches[6].tolist() == [[1000, 1001], [1010, 1011]]


def test_patchify_is_a_strided_convolution(rng):
    fusion = ContextFusion(4, 8, patch_size=4)
    images = torch.rand(1, 1, 3, 8, 8, generator=rng)
    patches = to_patches(images.permute(0, 1, 3, 4, 2), 4).flatten(2)
    kernel = fusion.color_proj.weight.view(8, 4, 4, 3).permute(0, 3, 1, 2)
    expected = functional.conv2d(images[0], kernel, fusion.color_proj.bias, stride=4)
    torch.testing.assert_close(fusion.color_proj(patches)[0], expected.flatten(2)[0].T)


def test_scale_is_the_mean_distance_and_positions_are_in_it(rng):
    # All points at distance 5 (3-4-0), so the scale is 5 and the positions are (0.6, 0, 0.8).
    pointmaps = torch.tensor([3.0, 0.0, 4.0]).expand(1, 2, 8, 8, 3)
    views, geometry = scene(pointmaps, torch.rand(1, 2, 3, 8, 8, generator=rng))
    context = ContextFusion(4, 8, patch_size=4, cells_per_side=2)(views, geometry)
    assert context.scale.item() == pytest.approx(5.0)
    torch.testing.assert_close(context.positions, torch.tensor([0.6, 0, 0.8]).expand(1, 8, 3))
    torch.testing.assert_close(
        context.cells[..., :3], torch.tensor([0.6, 0, 0.8]).expand(1, 8, 4, 3)
    )


def test_positions_are_pixels_and_cells_are_means():
    # x = column, y = row, z = 0 on 4 x 4 pixels, one patch of 2 x 2 cells of 2 x 2 pixels.
    rows, columns = torch.meshgrid(torch.arange(4.0), torch.arange(4.0), indexing="ij")
    pointmaps = torch.stack([columns, rows, torch.zeros(4, 4)], dim=-1)[None, None]
    images = (pointmaps / 4).permute(0, 1, 4, 2, 3)
    context = ContextFusion(4, 8, patch_size=4, cells_per_side=2)(*scene(pointmaps, images))
    scale = context.scale
    torch.testing.assert_close(context.positions * scale, torch.tensor([[[2.0, 2.0, 0.0]]]))
    # Means of columns and rows 0,1 and 2,3: 0.5 and 2.5; cells row-major.
    expected = torch.tensor([[0.5, 0.5, 0], [2.5, 0.5, 0], [0.5, 2.5, 0], [2.5, 2.5, 0]])
    torch.testing.assert_close(context.cells[0, 0, :, :3] * scale, expected)
    torch.testing.assert_close(context.cells[0, 0, :, 3:], expected / 4)


def test_unknown_points_are_left_out_of_the_means(rng):
    pointmaps = torch.tensor([3.0, 0.0, 4.0]).repeat(1, 1, 8, 8, 1)
    pointmaps[0, 0, :3] = torch.nan  # 3 rows of the first patches, with one cell row whole
    pointmaps[0, 0, 4:, 4:] = torch.inf  # the last patch whole
    views, geometry = scene(pointmaps, torch.rand(1, 1, 3, 8, 8, generator=rng))
    context = ContextFusion(4, 8, patch_size=4, cells_per_side=2)(views, geometry)
    assert context.scale.item() == pytest.approx(5.0)
    torch.testing.assert_close(context.positions[0, 0], torch.tensor([0.6, 0, 0.8]))
    torch.testing.assert_close(context.cells[0, 0, :, :3], torch.tensor([[0.6, 0, 0.8]] * 4))
    assert context.tokens.isfinite().all()
    assert context.cells.isfinite().all()


def test_features_of_another_patch_size_are_named(rng):
    views, geometry = scene(torch.rand(1, 1, 8, 8, 3, generator=rng), torch.rand(1, 1, 3, 8, 8))
    with pytest.raises(ValueError, match=r"have 16 patches of 2 pixels, .* features for 4"):
        ContextFusion(4, 8, patch_size=2)(views, geometry)


def test_features_and_tokens_are_normalised_and_colours_and_points_are_not(rng):
    pointmaps = torch.rand(1, 2, 8, 8, 3, generator=rng) + 1
    views, geometry = scene(pointmaps, torch.rand(1, 2, 3, 8, 8, generator=rng))
    fuse = ContextFusion(4, 8, patch_size=4, normalize_scale=False)

    def tokens(**changed: torch.Tensor) -> torch.Tensor:
        images = changed.pop("images", views.images)
        return fuse(Views(images), replace(geometry, **changed)).tokens

    plain = tokens()
    torch.testing.assert_close(plain.mean(-1), torch.zeros(1, 8), atol=1e-5, rtol=0)
    torch.testing.assert_close(plain.var(-1, unbiased=False), torch.ones(1, 8), atol=1e-2, rtol=0)
    louder = tokens(features=5 * geometry.features + 2)
    torch.testing.assert_close(louder, plain, atol=0.01, rtol=0)  # the norm's eps counts for less
    assert (tokens(pointmaps=5 * pointmaps) - plain).abs().max() > 0.1
    assert (tokens(images=views.images / 5) - plain).abs().max() > 0.1
