from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from instok3d.formats.ply import write_ply
from instok3d.formats.registry import read_splats
from instok3d.render import render
from instok3d.scene.scene import Scene
from instok3d.types import Cameras
from splat_scenes import psnr


def test_each_file_is_a_group_of_its_name(tmp_path: Path, scene: Scene):
    for item in scene.objects:
        degree = 0 if item.id == 1 else 1
        write_ply(tmp_path / f"thing_{item.id}.ply", scene.part(item.id), sh_degree=degree)
    (tmp_path / "meta.json").write_text("{}")
    splats = read_splats(tmp_path)
    assert splats.labels == {1: "thing_1", 2: "thing_3"}
    counts = [item.num_gaussians for item in scene.objects]
    assert splats.object_ids.bincount().tolist() == [0, *counts]
    torch.testing.assert_close(splats.gaussians.means, scene.part([1, 3]).means)
    assert splats.gaussians.sh.shape[1] == 4


def test_a_folder_without_plys_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="has no file that ends in"):
        read_splats(tmp_path)


def test_the_authors_scene_renders_like_their_photo(shared: Path):
    # Where the published groups cover the picture; the photo has a black rim (lens correction).
    # The focal length was fitted: the authors publish none.
    folder = shared / "data/instok3d_authors/demo/scene0694_01"
    splats = read_splats(folder / "splat")
    assert len(splats.labels) == 11
    camera = Cameras(
        torch.eye(4)[None], torch.tensor([[[307.8, 0, 128], [0, 307.8, 128], [0, 0, 1]]])
    )
    rendering = render(splats.gaussians, camera, 256, 256)
    photo = np.array(Image.open(folder / "scene_input.png").convert("RGB"))
    wanted = torch.from_numpy(photo).permute(2, 0, 1) / 255
    covered = rendering.alphas[0] > 0.8
    rim = torch.ones(256, 256, dtype=torch.bool)
    rim[6:-6, 6:-6] = False
    covered &= ~rim
    assert psnr(rendering.colors[0][:, covered], wanted[:, covered]) >= 24
