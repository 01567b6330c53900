"""Protocols on prepared folders: the frames of the papers, and null where there is no truth."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from flat_rooms import flat_room, oracle
from instok3d.datasets.prepared import (
    PreparedFrame,
    PreparedScenes,
    SceneInfo,
    refresh_index,
    write_scene,
)
from instok3d.datasets.prepared.format import Dataset
from instok3d.evaluation.dataset_protocols import (
    DatasetProtocol,
    frame_chooser,
    protocol_scenes,
    read_re10k_index,
)
from instok3d.evaluation.report import KEYS, as_json, as_table
from instok3d.evaluation.run import EvaluationReport, EvaluationSettings, evaluate
from instok3d.types import TokenGroups, Views
from mutations import of_json, survive


def prepared(
    folder: Path,
    dataset: Dataset = "scannet",
    *,
    names=("a",),
    truth: bool = True,
    num_frames: int = 16,
    standing: tuple[int, ...] = (),
):
    """Hand-made rooms of 16 frames as a prepared test folder; without truth photos and cameras.

    At standing frames the camera is where it was at frame 0.
    """
    room = flat_room()
    for name in names:
        frames = [
            PreparedFrame(
                source=str(k),
                image=room.images[k],
                world_from_cam=room.world_from_cam[0 if k in standing else k].astype(np.float64),
                intrinsics=room.intrinsics[k].astype(np.float64),
                depth_thousandths=(room.depths_m[k] * 1000).astype(np.uint16) if truth else None,
                instances=room.instances[k].astype(np.uint16) if truth else None,
            )
            for k in range(num_frames)
        ]
        unit = "metre" if dataset == "scannet" else "arbitrary"
        write_scene(folder, SceneInfo(name, dataset, "test", unit), frames)
    refresh_index(folder)
    return PreparedScenes(folder, splits=("test",))


def contexts_and_targets(scenes: PreparedScenes, protocol: DatasetProtocol, **options):
    choices = frame_chooser(protocol, **options)(scenes, 0)
    return [(choice.context, choice.target) for choice in choices]


def measured(
    scenes: PreparedScenes, protocol: DatasetProtocol, *, settings=None, **options
) -> EvaluationReport:
    """The figures of a model that knows the truth of the flat room."""
    settings = settings or EvaluationSettings()
    choose = frame_chooser(protocol, **options)
    asked = list(protocol_scenes(scenes, protocol, choose, model_unit=settings.model_unit))
    room = flat_room()

    def model(views: Views) -> TokenGroups:
        (sample,) = [
            sample
            for scene in asked
            for sample in scene.samples
            if torch.equal(sample.context.images, views.images)
        ]
        ids = torch.from_numpy(room.instances)
        # The answer may use what the test scene lacks: depth from the planes of the room.
        frames = [
            next(k for k in range(16) if np.array_equal(_bytes(image), room.images[k]))
            for image in views.images[0]
        ]
        length = float(sample.context.cam_from_world[0, -1, :3, 3].norm()) / float(
            np.linalg.norm(room.world_from_cam[frames[-1], :3, 3]
                           - room.world_from_cam[frames[0], :3, 3])
        )  # fmt: skip
        depths = torch.from_numpy(room.depths_m[frames]).float()[None] * length
        known = replace(
            sample,
            context=replace(sample.context, depths=depths),
            context_instances=ids[frames][None],
        )
        return oracle(known)(views)

    return evaluate(model, asked, settings, protocol=protocol, model_name="oracle")


def _bytes(image: torch.Tensor) -> np.ndarray:
    return (image.permute(1, 2, 0) * 255).round().to(torch.uint8).numpy()


def test_frames_are_those_of_the_published_protocols(tmp_path: Path):
    scenes = prepared(tmp_path)
    # method: i mod 8 in {1, 4} with both neighbours inside 16 frames: 1, 4, 9, 12.
    pairs = [((i - 1, i + 1), (i,)) for i in (1, 4, 9, 12)]
    assert contexts_and_targets(scenes, "scannet-2view") == pairs
    eight = ((0, 2, 4, 6, 8, 10, 12, 14), (1, 3, 5, 7, 9, 11, 13))
    assert contexts_and_targets(scenes, "scannet-8view") == [eight]
    # i mod 8 in {2, 6} with i - 2 and i + 2 inside: 2, 6, 10; the middle one is 6.
    assert contexts_and_targets(scenes, "mipnerf360-2view") == [((4, 8), (6,))]
    every = [((i - 2, i + 2), (i,)) for i in (2, 6, 10)]
    assert contexts_and_targets(scenes, "mipnerf360-2view", all_targets=True) == every


def test_scannet_measures_everything(tmp_path: Path):
    report = measured(prepared(tmp_path, names=("a",)), "scannet-2view")
    figures = report.figures
    assert (figures.scenes, figures.targets) == (1, 4)
    assert figures.psnr > 24
    assert figures.ap50 == figures.ap25 == 1.0
    assert figures.rotation_deg < 0.01
    assert figures.depth_rel < 1e-3
    result = as_json(report, details=True)
    assert result["details"]["scenes"] == ["a"]
    assert result["details"]["levels"] == {}
    assert "seeds" not in result["details"]
    assert "all scenes" in as_table(report)


def test_what_has_no_truth_is_null_and_the_rest_is_measured(tmp_path: Path):
    index = {"a": {"context": [4, 8], "target": [5, 6, 7], "overlap": 0.5}}
    report = measured(
        prepared(tmp_path, "re10k", truth=False), "re10k-2view", re10k_index=index
    )  # fmt: skip
    figures = report.figures
    assert (figures.scenes, figures.targets) == (1, 3)
    assert figures.psnr > 24
    assert figures.rotation_deg < 0.01
    assert figures.direction_deg < 0.1
    for name in ("ap", "ap50", "ap25", "depth_rel", "length_rel", "psnr_depth_scaled"):
        assert getattr(figures, name) is None, name
    assert set(as_json(report)) == {"protocol", "model", "scenes", *KEYS}
    json.dumps(as_json(report, details=True), allow_nan=False)
    assert "AP was not measured" in as_table(report)
    assert "No true depth is known" in as_table(report)
    given = measured(
        PreparedScenes(tmp_path, splits=("test",)),
        "re10k-2view",
        settings=EvaluationSettings(geometry="given", baselines=True),
        re10k_index=index,
    )
    assert given.figures.rotation_deg is None
    assert given.figures.psnr > 24


@pytest.mark.parametrize(
    ("dataset", "protocol", "model_unit", "unit", "true"),
    [
        ("scannet", "scannet-2view", "metre", "metre", True),
        ("scannet", "scannet-2view", "baseline", "baseline", True),
        ("scannet", "scannet-2view", None, "metre", False),
        ("mipnerf360", "mipnerf360-2view", "metre", "baseline", False),
        ("mipnerf360", "mipnerf360-2view", "baseline", "baseline", True),
        ("mipnerf360", "mipnerf360-2view", None, "baseline", False),
    ],
)
def test_targets_are_true_where_model_and_scene_have_one_unit(
    tmp_path: Path, dataset, protocol, model_unit, unit, true
):
    scenes = prepared(tmp_path, dataset)
    settings = EvaluationSettings(geometry="intrinsics", model_unit=model_unit)
    (scene,) = protocol_scenes(
        scenes, protocol, frame_chooser(protocol), num_scenes=1, model_unit=model_unit
    )
    assert scene.unit == unit
    report = measured(scenes, protocol, settings=settings)
    assert report.true_targets == (1 if true else 0)
    assert report.figures.psnr > 24
    assert report.figures.rotation_deg < 0.01
    said = "rendered at their true cameras, in the unit of the data"
    assert (said in as_table(report)) == true
    assert ("brought into the predicted world" in as_table(report)) != true


def test_targets_are_as_they_are_asked_for(tmp_path: Path):
    scenes = prepared(tmp_path)
    for kind, true in (("true", 1), ("aligned", 0)):
        settings = EvaluationSettings(
            geometry="intrinsics", model_unit="metre", target_cameras=kind
        )
        assert measured(scenes, "scannet-2view", settings=settings).true_targets == true
    bare = EvaluationSettings(geometry="predicted", model_unit="metre")
    assert measured(scenes, "scannet-2view", settings=bare).true_targets == 0
    with pytest.raises(ValueError, match="given cameras have true targets"):
        EvaluationSettings(geometry="given", target_cameras="aligned")


def test_the_index_of_re10k_leaves_scenes_out_with_a_warning(tmp_path: Path):
    scenes = prepared(tmp_path, "re10k", names=("a", "b", "c"), truth=False)
    index = {"a": None, "b": {"context": [0, 4], "target": [2]},
             "c": {"context": [0, 40], "target": [2]}}  # fmt: skip
    choose = frame_chooser("re10k-2view", re10k_index=index)
    with pytest.warns(UserWarning, match="scene") as said:
        found = list(protocol_scenes(scenes, "re10k-2view", choose))
    assert [scene.name for scene in found] == ["b"]
    text = " ".join(str(each.message) for each in said)
    assert "scene a has no sample by re10k-2view" in text
    assert "frames [40] of the evaluation index were not prepared" in text
    # Contexts at frames 0 and 4: their distance is the unit.
    cameras = found[0].samples[0].context.cam_from_world
    assert cameras is not None
    assert float(cameras[0, 1, :3, 3].norm()) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.filterwarnings("ignore:scene a has no sample")
def test_a_scene_too_short_for_eight_views_is_left_out_with_a_warning(tmp_path: Path):
    prepared(tmp_path, names=("a",), num_frames=14)
    scenes = prepared(tmp_path, names=("b",))
    with pytest.warns(UserWarning, match="scene a: the eight-view protocol needs 15 frames"):
        found = list(protocol_scenes(scenes, "scannet-8view", frame_chooser("scannet-8view")))
    assert [scene.name for scene in found] == ["b"]


def test_a_sample_without_baseline_is_left_out_alone(tmp_path: Path):
    scenes = prepared(tmp_path, "mipnerf360", truth=False, standing=(4,))
    choose = frame_chooser("mipnerf360-2view", all_targets=True)
    with pytest.warns(UserWarning, match="scene a") as said:
        (scene,) = protocol_scenes(scenes, "mipnerf360-2view", choose)
    assert len(said) == 1  # contexts 0 and 4 stand at one place; 4 and 8, 8 and 12 do not
    assert len(scene.samples) == 2


def test_a_protocol_refuses_another_data_set(tmp_path: Path):
    scenes = prepared(tmp_path, "re10k")
    with pytest.raises(ValueError, match="is of re10k, scannet-2view is for scannet"):
        list(protocol_scenes(scenes, "scannet-2view", frame_chooser("scannet-2view")))
    with pytest.raises(ValueError, match="at least 1, got 0"):
        list(protocol_scenes(scenes, "re10k-2view", lambda *_: [], num_scenes=0))
    with pytest.raises(ValueError, match="give its file with --index"):
        frame_chooser("re10k-2view")


def test_an_index_that_is_none_is_refused(tmp_path: Path):
    path = tmp_path / "index.json"
    with pytest.raises(FileNotFoundError, match="no evaluation index"):
        read_re10k_index(path)
    for text in ("{", "[]", '{"a": {"context": [1, 2]}}', '{"a": {"context": 1, "target": [2]}}'):
        path.write_text(text)
        with pytest.raises(ValueError, match="is no evaluation index"):
            read_re10k_index(path)


def test_the_real_index_of_re10k_is_read(shared: Path):
    index = read_re10k_index(shared / "data" / "re10k" / "evaluation_index_re10k.json")
    assert len(index) == 7194
    assert sum(entry is not None for entry in index.values()) == 5601


def test_a_damaged_index_is_read_or_refused_in_one_line(tmp_path):
    path = tmp_path / "index.json"
    path.write_text(json.dumps({"a": {"context": [1, 5], "target": [2, 3]}, "b": None}))
    assert survive(path, lambda: read_re10k_index(path), of_json, 120)


@pytest.mark.parametrize("frames", ["12", [], [-1, 3], [1.5], [True], [2**70], ["1"], None, {}])
def test_frames_that_cannot_be_are_refused(tmp_path, frames):
    path = tmp_path / "index.json"
    path.write_text(json.dumps({"a": {"context": frames, "target": [2, 3]}}))
    with pytest.raises(ValueError, match=r"index\.json is no evaluation index"):
        read_re10k_index(path)
