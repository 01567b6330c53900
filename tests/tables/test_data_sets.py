"""Tables of the paper's data sets: prepared scenes of made-up rooms in place of real ones."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fake_rooms import fake_scene
from instok3d.cli import main
from instok3d.datasets.prepared import PreparedFrame, SceneInfo, refresh_index, write_scene
from instok3d.datasets.prepared.format import Dataset, Split
from instok3d.datasets.prepared.masks import MASKS_FORMAT, MASKS_RECORD
from instok3d.files import sha256_of, write_json
from instok3d.tables.data_sets import (
    data_set_of,
    prepared_set,
    tables_of,
    training_digest,
    training_folders,
)
from instok3d.tables.scene_sets import SceneSet

SIZE = 32
TABLE = "id\traw_category\tnyu40class\n1\toffice chair\tchair\n2\tdesk\tdesk\n3\tcouch\tsofa\n"


def write(folder: Path, dataset: Dataset, scenes: dict[str, Split], num_frames: int) -> Path:
    """Box rooms as prepared scenes; those of RealEstate10K have masks of SAM 2 and no truth."""
    known = dataset == "scannet"
    for seed, (name, split) in enumerate(scenes.items()):
        room = fake_scene(seed, SIZE, num_frames)
        ids = room.instances.numpy().astype(np.uint16)
        frames = [
            PreparedFrame(
                source=str(k),
                image=room.images[k].numpy(),
                world_from_cam=room.world_from_cam[k].double().numpy(),
                intrinsics=room.intrinsics[k].double().numpy(),
                depth_thousandths=(room.depths_m[k].numpy() * 1000).astype(np.uint16)
                if known
                else None,
                instances=ids[k] if known else None,
                labels=ids[k] if known else None,
            )
            for k in range(num_frames)
        ]
        unit = "metre" if known else "arbitrary"
        write_scene(folder, SceneInfo(name, dataset, split, unit), frames)
        if dataset == "re10k":
            masks = folder / name / "masks_sam2"
            masks.mkdir()
            for k in range(num_frames):
                Image.fromarray(ids[k]).save(masks / f"{k:06d}.png")
            files = {p.name: [p.stat().st_size, sha256_of(p)] for p in masks.glob("*.png")}
            record = {"format": MASKS_FORMAT, "statistics": {}, "files": files}
            write_json(masks / MASKS_RECORD, record)
    if known:
        (folder / "scannetv2-labels.combined.tsv").write_text(TABLE)
    refresh_index(folder)
    return folder


@pytest.fixture(scope="module")
def scannet(tmp_path_factory) -> Path:
    scenes: dict[str, Split] = {"a": "train", "b": "train", "y": "test", "z": "test"}
    return write(tmp_path_factory.mktemp("scannet"), "scannet", scenes, 16)


@pytest.fixture(scope="module")
def re10k(tmp_path_factory) -> Path:
    scenes: dict[str, Split] = {"a": "train", "b": "train", "c": "test", "d": "test"}
    return write(tmp_path_factory.mktemp("re10k"), "re10k", scenes, 46)


@pytest.fixture(scope="module")
def mipnerf360(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("mipnerf360"), "mipnerf360", {"garden": "test"}, 16)


@pytest.fixture
def index(tmp_path) -> Path:
    entries = {"c": {"context": [0, 40], "target": [10, 20, 30]}, "d": None}
    write_json(tmp_path / "index.json", entries)
    return tmp_path / "index.json"


def test_folders_say_what_tables_are_made_of(scannet, re10k, mipnerf360, rooms, tmp_path):
    assert [data_set_of(each) for each in (scannet, re10k, mipnerf360, rooms)] == [
        "scannet", "re10k", "mipnerf360", "rooms"
    ]  # fmt: skip
    assert tables_of([scannet, re10k]) == "scannet"
    assert tables_of([rooms]) == "rooms" == tables_of([])
    with pytest.raises(ValueError, match=r"holds rooms and .* prepared scenes: tables are made"):
        tables_of([scannet, rooms])
    with pytest.raises(FileNotFoundError, match=r"holds no rooms .* and no prepared scenes"):
        tables_of([tmp_path])
    mixed = write(tmp_path / "mixed", "scannet", {"a": "train"}, 2)
    write(mixed, "mipnerf360", {"b": "train"}, 2)
    with pytest.raises(ValueError, match="holds scenes of mipnerf360 and scannet"):
        data_set_of(mixed)


def test_trainings_see_the_training_scenes_of_their_data_set(scannet, re10k, mipnerf360):
    every = [scannet, re10k, mipnerf360]
    assert training_folders(every, "scannet") == [scannet]
    assert training_folders(every, "re10k") == [re10k]
    assert training_digest([scannet]) == training_digest([scannet]) != training_digest([re10k])
    with pytest.raises(FileNotFoundError, match=r"no training scene of re10k in .*mipnerf360"):
        training_folders([mipnerf360], "re10k")


def test_test_scenes_are_those_that_the_protocols_of_the_papers_can_use(
    scannet, re10k, mipnerf360, index
):
    every = [scannet, re10k, mipnerf360]
    two = prepared_set(every, "test", 2, None, None)
    assert isinstance(two, SceneSet)
    assert two.names == ["y", "z"]
    assert prepared_set(every, "test", 2, 1, None).names == ["y"]
    # LSM: i mod 8 in {1, 4}; Uni3R: the even ones of 15 frames.
    assert [s.context.images.shape[1] for s in two.scene(0, 2, None).samples] == [2] * 4
    (sample,) = prepared_set(every, "test", 8, None, None).scene(1, 8, None).samples
    assert sample.context.images.shape[1] == 8
    assert sample.words[0][1].nyu40 == "chair"
    clips = prepared_set(every, "RealEstate10K", 2, None, index)
    assert clips.names == ["c"]  # d is left out by the index
    assert clips.scene(0, 2, None).samples[0].target.images.shape[1] == 3
    assert prepared_set(every, "MipNeRF360", 2, None, None).names == ["garden"]


def test_what_is_missing_is_named(scannet, re10k, mipnerf360, index):
    with pytest.raises(FileNotFoundError, match="no test scene of ScanNet in"):
        prepared_set([re10k], "test", 2, None, None)
    with pytest.raises(FileNotFoundError, match="no test scene of MipNeRF360 in"):
        prepared_set([], "MipNeRF360", 2, None, None)
    with pytest.raises(FileNotFoundError, match="give the file with --index"):
        prepared_set([re10k], "RealEstate10K", 2, None, None)
    write_json(index, {"c": None})
    with pytest.raises(ValueError, match="can use none of the 2 test scenes"):
        prepared_set([re10k], "RealEstate10K", 2, None, index)


def test_the_papers_tables_are_made_of_prepared_scenes(
    scannet, re10k, mipnerf360, index, tmp_path, capsys
):
    data = ["--data", *map(str, (scannet, re10k, mipnerf360))]
    words = ["tables", "5", "6", *data, "--index", str(index), "--quick", "--threads", "1"]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    tables = [json.loads((tmp_path / f"out/table{n}.json").read_text()) for n in (5, 6)]
    rows = {row["label"]: row["figures"] for table in tables for row in table["rows"]}
    assert list(rows) == ["C3G style", "Ours", "Uni3R style, MipNeRF360", "Ours, MipNeRF360"]
    assert all(figures["psnr"] > 0 for figures in rows.values())
    assert "Rendered rooms" not in (tmp_path / "out/table5.md").read_text()
    capsys.readouterr()
    words[1:3] = ["all"]
    assert main([*words, "-o", str(tmp_path / "plan"), "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "train re10k: 1 updates, masks sam2" in text
    assert "train broken-tracks" not in text
    assert "missing" not in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--captures", "x"], "--captures is of Table 6 on rooms"),
        (["5"], "give the file with --index evaluation_index_re10k.json"),
    ],
)
def test_what_does_not_belong_to_the_data_is_refused(words, message, scannet, re10k, capsys):
    data = ["--data", str(scannet), str(re10k)]
    assert main(["tables", *words, *data, "--quick", "-o", "nowhere"]) == 2
    assert message in capsys.readouterr().err


def test_an_index_of_clips_is_no_matter_of_rooms(rooms, capsys):
    words = ["tables", "1", "--data", str(rooms), "--index", "x", "--quick", "-o", "nowhere"]
    assert main(words) == 2
    assert "--index is of RealEstate10K" in capsys.readouterr().err
