"""Folders of id maps: whole or not there, resumed, and read back by what reads prepared data."""

import hashlib
import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from instok3d.datasets.prepared import PreparedScenes, verify
from instok3d.datasets.prepared.masks import read_masks_record
from instok3d.datasets.prepared.verifying import verify_scene
from instok3d.datasets.pseudo_labels import writing
from instok3d.datasets.pseudo_labels.association import AssociationConfig
from instok3d.datasets.pseudo_labels.writing import LabelConfig, footage_clip, label, scene_clip
from instok3d.locking import bring_back
from kill_points import every_kill
from prepared_scenes import made_folder
from scannet_files import huge_png
from true_masks import TrueClip, TrueMasks, boxes_clip

CONFIG = LabelConfig(AssociationConfig(keyframe_step=2, min_area_share=0.0))


@pytest.fixture
def prepared(tmp_path: Path) -> Path:
    return made_folder(tmp_path / "prepared", {"a": "train", "b": "val"})


def truth_of(scene: Path) -> TrueMasks:
    """The pictures of a prepared scene, with two boxes in each."""
    images = np.stack([np.array(Image.open(p)) for p in sorted((scene / "images").iterdir())])
    boxes = boxes_clip([{1: (0, 0, 3, 3), 2: (3, 4, 6, 8)}] * len(images), images.shape[1:3])
    return TrueMasks(TrueClip(images, boxes.ids))


def test_a_prepared_scene_gets_masks_that_training_reads(prepared):
    scene = prepared / "a"
    done = label(scene_clip(scene, "sam2"), truth_of(scene), CONFIG)
    assert done.outcome == "made"
    assert done.folder == scene / "masks_sam2"
    frames = PreparedScenes(prepared, masks="sam2").frames(0, [4, 0])
    np.testing.assert_array_equal(
        frames.instances.numpy(), np.array([0, 2, 1])[truth_of(scene).clip.ids[[4, 0]]]
    )
    assert list(verify(prepared)) == []
    assert Image.open(scene / "masks_sam2" / "000003.png").mode == "I;16"


def test_the_record_says_how_the_masks_were_made_and_how_good_they_are(prepared):
    scene = prepared / "a"
    done = label(scene_clip(scene, "sam2"), truth_of(scene), CONFIG)
    record = json.loads((done.folder / "masks.json").read_text())
    assert record["format"] == "instok3d-masks-1"
    assert record["model"] == "truth"
    assert record["weights_sha256"] == "0" * 64
    assert record["library"] == "none 0"
    assert record["config"]["association"]["keyframe_step"] == 2
    assert record["statistics"] == asdict(done.statistics)
    # boxes of 9 and 12 of 48 pixels in all five frames
    assert record["statistics"]["coverage"] == 21 / 48
    assert (done.statistics.tracks, done.statistics.mean_track_frames) == (2, 5)
    data = (done.folder / "000001.png").read_bytes()
    assert record["files"]["000001.png"] == [len(data), hashlib.sha256(data).hexdigest()]
    assert len(record["files"]) == 5


def test_masks_with_equal_settings_are_kept_and_others_refused(prepared):
    scene = prepared / "a"
    clip, truth = scene_clip(scene, "sam2"), truth_of(scene)
    first = label(clip, truth, CONFIG)
    truth.proposed_on.clear()
    again = label(clip, truth, CONFIG)
    assert (again.outcome, again.statistics) == ("there already", first.statistics)
    assert truth.proposed_on == []
    other = LabelConfig(AssociationConfig(keyframe_step=3, min_area_share=0.0))
    with pytest.raises(ValueError, match="was made with another config; pass --overwrite"):
        label(clip, truth, other)
    assert label(clip, truth, other, overwrite=True).outcome == "made"
    assert json.loads((first.folder / "masks.json").read_text())["config"]["association"][
        "keyframe_step"
    ] == 3  # fmt: skip


def test_a_damaged_record_is_said_and_overwritten(prepared):
    scene = prepared / "a"
    clip = scene_clip(scene, "sam2")
    label(clip, truth_of(scene), CONFIG)
    (clip.target / "masks.json").write_text("{")
    with pytest.raises(ValueError, match=r"masks\.json is damaged .* --overwrite"):
        label(clip, truth_of(scene), CONFIG)
    label(clip, truth_of(scene), CONFIG, overwrite=True)
    assert list(verify(prepared)) == []


def test_a_run_that_fails_leaves_what_was_there(prepared, monkeypatch):
    scene = prepared / "a"
    clip = scene_clip(scene, "sam2")
    label(clip, truth_of(scene), CONFIG)
    before = {path.name: path.read_bytes() for path in clip.target.iterdir()}

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(writing.StatisticsOfClip, "result", stop)
    with pytest.raises(KeyboardInterrupt):
        label(clip, truth_of(scene), CONFIG, overwrite=True)
    assert {path.name: path.read_bytes() for path in clip.target.iterdir()} == before
    assert list(verify(prepared)) == []  # nothing half-written either


def test_footage_gets_maps_of_its_own_size_and_names(tmp_path):
    truth = TrueMasks(boxes_clip([{1: (2, 2, 8, 8)}] * 3))
    paths = []
    for number, image in enumerate(truth.clip.images):
        large = Image.fromarray(image).resize((64, 32), Image.Resampling.NEAREST)
        paths.append(tmp_path / f"IMG_{number}.png")
        large.save(paths[-1])
    config = LabelConfig(AssociationConfig(min_area_share=0.0), max_side=32)
    steps = []
    label(footage_clip(paths, tmp_path / "ids"), truth, config, progress=steps.append)
    assert steps == [1, 1, 1]
    assert sorted(p.name for p in (tmp_path / "ids").iterdir()) == [
        "IMG_0.png", "IMG_1.png", "IMG_2.png", "masks.json"
    ]  # fmt: skip
    ids = np.array(Image.open(tmp_path / "ids" / "IMG_2.png"))
    np.testing.assert_array_equal(ids, truth.clip.ids[2].repeat(2, axis=0).repeat(2, axis=1))


def test_a_picture_of_another_size_is_named(tmp_path):
    for name, size in (("a.png", (8, 6)), ("b.png", (4, 6))):
        Image.new("RGB", size).save(tmp_path / name)
    clip = footage_clip([tmp_path / "a.png", tmp_path / "b.png"], tmp_path / "ids")
    with pytest.raises(ValueError, match=r"b\.png has 4 x 6 pixels, the pictures before it 8 x 6"):
        label(clip, TrueMasks(boxes_clip([{}])), CONFIG)
    assert not (tmp_path / "ids").exists()


def test_pictures_with_one_name_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"would have the id map a\.png; rename one"):
        footage_clip([tmp_path / "a.jpg", tmp_path / "a.png"], tmp_path / "ids")


def test_a_folder_of_something_else_is_never_replaced(tmp_path):
    truth = TrueMasks(boxes_clip([{}]))
    Image.fromarray(truth.clip.images[0]).save(tmp_path / "a.png")
    clip = footage_clip([tmp_path / "a.png"], tmp_path)
    with pytest.raises(FileExistsError, match=r"no folder of id maps .masks\.json is missing"):
        label(clip, truth, CONFIG, overwrite=True)
    assert (tmp_path / "a.png").is_file()


@pytest.mark.parametrize("data", [b"no picture", huge_png()])
def test_a_picture_that_cannot_be_read_is_named(tmp_path, data: bytes):
    (tmp_path / "a.png").write_bytes(data)
    clip = footage_clip([tmp_path / "a.png"], tmp_path / "ids")
    with pytest.raises(ValueError, match=r"a\.png cannot be read as a picture"):
        label(clip, TrueMasks(boxes_clip([{}])), CONFIG)
    assert not (tmp_path / "ids").exists()


def test_a_clip_in_which_nothing_is_found_is_written_with_a_warning(tmp_path):
    truth = TrueMasks(boxes_clip([{}]))
    Image.fromarray(truth.clip.images[0]).save(tmp_path / "a.png")
    with pytest.warns(UserWarning, match="no mask was found in 1 pictures"):
        done = label(footage_clip([tmp_path / "a.png"], tmp_path / "ids"), truth, CONFIG)
    assert done.statistics.coverage == 0


def test_two_runs_do_not_make_the_same_masks(prepared):
    scene = prepared / "a"
    clip, heard = scene_clip(scene, "sam2"), []

    def second_run(_: int) -> None:
        with pytest.raises(ValueError, match=r"another run is making .*masks_sam2; wait") as error:
            label(clip, truth_of(scene), CONFIG)
        heard.append(error)
        (fault,) = verify_scene(scene)
        assert fault.path.startswith("a/.instok3d-")
        assert fault.path.endswith(".part")

    label(clip, truth_of(scene), CONFIG, progress=second_run)
    assert len(heard) == 5
    assert list(verify(prepared)) == []
    assert not [path for path in scene.iterdir() if path.name.startswith(".")]


def test_killed_at_any_operation_it_leaves_the_old_or_the_new_masks(prepared, tmp_path):
    scene = prepared / "a"
    old = LabelConfig(replace(CONFIG.association, keyframe_step=1))
    label(scene_clip(scene, "sam2"), truth_of(scene), old)

    def begun() -> Path:
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        return shutil.copytree(scene, tmp_path / "work")

    def replace_masks(folder: Path) -> None:
        label(scene_clip(folder, "sam2"), truth_of(folder), CONFIG, overwrite=True)

    seen = set()
    for folder in every_kill(begun, replace_masks, step=4):
        bring_back(folder / "masks_sam2")
        record = read_masks_record(folder / "masks_sam2")
        step = record.settings["config"]["association"]["keyframe_step"]
        seen.add(step)
        label(scene_clip(folder, "sam2"), truth_of(folder), CONFIG, overwrite=step == 1)
        assert sorted(path.name for path in folder.iterdir()) == [
            "depths", "images", "instances", "masks_sam2", "scene.json"
        ]  # fmt: skip
    assert seen == {1, 2}


def test_training_refuses_masks_that_do_not_fit_the_frames_or_each_other(tmp_path):
    folder = made_folder(tmp_path, {"a": "train", "b": "train"})
    for name in ("a", "b"):
        label(scene_clip(folder / name, "sam2"), truth_of(folder / name), CONFIG)
    assert len(PreparedScenes(folder, masks="sam2")) == 2

    path = folder / "b/masks_sam2/masks.json"
    record = json.loads(path.read_text())

    def changed(**changes: object) -> None:
        path.write_text(json.dumps(record | changes))

    changed(weights_sha256="f" * 64)
    with pytest.raises(ValueError, match=r"b/masks_sam2 was made with another weights_sha256 than"):
        PreparedScenes(folder, masks="sam2")
    changed(files=dict(list(record["files"].items())[:4]))
    with pytest.raises(ValueError, match=r"b/masks_sam2 has 4 id maps for 5 frames"):
        PreparedScenes(folder, masks="sam2")
    changed(format="instok3d-masks-9")
    with pytest.raises(ValueError, match=r"masks\.json is damaged .*instok3d-masks-9"):
        PreparedScenes(folder, masks="sam2")
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"no masks\.json in .*b/masks_sam2"):
        PreparedScenes(folder, masks="sam2")
