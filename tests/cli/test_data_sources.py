from pathlib import Path

import pytest
import torch
from PIL import Image

from colmap_models import write_colmap
from instok3d.cli import main
from instok3d.datasets.prepared import read_index


def colmap_scene(folder: Path, images: str) -> Path:
    write_colmap(
        folder / "sparse/0",
        {1: ("PINHOLE", 40, 30, [35.0, 35.0, 20.0, 15.0])},
        [("a.png", torch.eye(4), 1)],
        ".bin",
    )
    (folder / images).mkdir()
    Image.new("RGB", (40, 30)).save(folder / images / "a.png")
    return folder


@pytest.mark.parametrize(
    ("source", "images", "split"),
    [("colmap", "images", "train"), ("mipnerf360", "images_4", "test"), ("footage", "", "train")],
)
def test_each_kind_of_photos_is_prepared_by_name(tmp_path, capsys, source, images, split):
    scene = colmap_scene(tmp_path / "in/kitchen", images or "photos")
    folder = scene if images else scene / "photos"
    options = [] if images else ["--cameras", str(scene), "--name", "kitchen"]
    arguments = [str(folder), "-o", str(tmp_path / "out"), "--size", "16", "--workers", "1"]
    assert main(["data", "prepare", source, *arguments, *options]) == 0
    assert "1 new scenes of 1 frames" in capsys.readouterr().out
    entry = read_index(tmp_path / "out")["kitchen"]
    assert (entry["dataset"], entry["split"], entry["cameras"]) == (source, split, True)


def test_scenes_left_out_are_counted_without_failing(tmp_path, capsys):
    (tmp_path / "in/train").mkdir(parents=True)
    wide = [0.2, 0.2, 0.5, 0.5, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
    clip = {"key": "a1", "cameras": torch.tensor([wide]), "images": [torch.ones(3).byte()]}
    torch.save([clip], tmp_path / "in/train/000000.torch")
    arguments = [str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--workers", "1"]
    assert main(["data", "prepare", "re10k", *arguments]) == 0
    assert "left out 1 scenes: a field of view over 100 degrees" in capsys.readouterr().out
