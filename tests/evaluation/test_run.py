import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from flat_rooms import FlatRooms, oracle
from instok3d.evaluation.figures import OBJECTS, summarize
from instok3d.evaluation.instance_ap import ApSettings
from instok3d.evaluation.object_quality import ObjectScore
from instok3d.evaluation.prediction import predict
from instok3d.evaluation.protocols import ProtocolScene, protocol_rooms
from instok3d.evaluation.report import (
    KEYS,
    RESULTS_HEADER,
    as_json,
    as_table,
    results_header,
    results_rows,
)
from instok3d.evaluation.run import EvaluationReport, EvaluationSettings, evaluate
from instok3d.evaluation.scores import GeometryScore, SceneScore, ViewScore, score_views
from instok3d.evaluation.sheet import recolored, write_sheet
from instok3d.objectives.lpips import Lpips
from instok3d.types import TokenGroups, Views

SEEDS = [2_000_000, 2_000_001]


def knowing_model(rooms: FlatRooms, *, targets: int):
    """Answers each sample with its truth, found by its photos."""
    (room,) = protocol_rooms(rooms, [0], "rooms-2view", targets_per_scene=targets)

    def model(views: Views) -> TokenGroups:
        (match,) = [s for s in room.samples if torch.equal(s.context.images, views.images)]
        return oracle(match, unit=1.3)(views)

    return model


@pytest.fixture(scope="module")
def report() -> EvaluationReport:
    rooms = FlatRooms(SEEDS, ["hard", "easy"])
    return evaluate(
        knowing_model(rooms, targets=2),
        protocol_rooms(rooms, [0, 1], "rooms-2view", targets_per_scene=2),
        EvaluationSettings(baselines=True),
        protocol="rooms-2view",
        model_name="oracle",
    )


def test_a_model_that_knows_the_truth_measures_so(report):
    figures = report.figures
    assert (figures.scenes, figures.targets) == (2, 4)
    assert figures.psnr > 24
    assert (figures.ap50, figures.ap25, figures.ap50_scene_mean) == (1.0, 1.0, 1.0)
    assert figures.ap > 0.6
    assert figures.rotation_deg < 0.01
    assert figures.direction_deg < 0.1
    assert figures.length_rel < 1e-3
    assert figures.depth_rel < 1e-5
    # Without the scale every depth is d / 1.3: an error of 1 - 1 / 1.3.
    assert figures.depth_rel_unscaled == pytest.approx(1 - 1 / 1.3, abs=1e-5)
    assert figures.groups_used == 3
    assert figures.instances_per_view == 3
    assert figures.lpips is None
    assert list(report.levels) == ["easy", "hard"]
    assert report.levels["hard"].targets == 2
    assert report.scenes == tuple(str(seed) for seed in SEEDS)


def test_baselines_have_pictures_or_masks_and_no_geometry(report):
    photo = report.baselines["nearest context photo"]
    clusters = report.baselines["colour clusters of the target photo"]
    assert photo.psnr > 10
    assert photo.ap is photo.rotation_deg is photo.groups_used is None
    assert clusters.psnr is None
    assert 0 < clusters.ap50 <= 1
    assert report.baselines["context photo warped by depth"].psnr > photo.psnr


def test_given_geometry_is_not_measured_against_itself():
    rooms = FlatRooms(SEEDS, ["easy", "easy"])
    (room,) = protocol_rooms(rooms, [0], "rooms-8view")
    report = evaluate(
        oracle(room.samples[0], stride=3),
        [room],
        EvaluationSettings(geometry="given"),
        protocol="rooms-8view",
        model_name="oracle",
    )
    assert report.figures.targets == 7
    assert report.figures.ap50 == 1.0
    assert report.figures.rotation_deg is report.figures.depth_rel is None
    assert "not measured" in as_table(report)


def test_no_room_is_an_error():
    rooms = FlatRooms(SEEDS, ["easy", "easy"])
    with pytest.raises(ValueError, match="at least one scene"):
        evaluate(knowing_model(rooms, targets=1), [], protocol="rooms-2view", model_name="none")


def test_json_has_the_agreed_keys_and_null_for_what_is_missing(report):
    plain = as_json(report)
    assert list(plain) == ["protocol", "model", "scenes", *KEYS]
    assert plain["lpips"] is None
    assert plain["scenes"] == 2
    whole = as_json(report, details=True)
    assert set(whole) - set(plain) == {"details"}
    text = json.dumps(whole, allow_nan=False)
    assert json.loads(text)["details"]["levels"]["easy"]["targets"] == 2


def test_table_and_rows_name_every_method(report):
    table = as_table(report)
    rows = results_rows(
        report, command="instok3d evaluate rooms-2view", commit="abc", seed=3, machine="two cores"
    )
    for name in ("easy", "hard", "nearest context photo"):
        assert name in table
    assert "LPIPS was not measured" in table
    lines = rows.splitlines()
    assert len(lines) == 1 + len(report.baselines)
    columns = RESULTS_HEADER.splitlines()[0].count("|")
    assert all(line.count("|") == columns for line in lines)


def test_figures_of_scores_by_hand():
    # Cameras: rooms have medians 2 (of 1, 2, 9) and 4: their median is 3. Depth: means .2 and .4.
    def geometry(rotation: float, depth: float) -> GeometryScore:
        return GeometryScore(rotation, None, 0.0, depth, 0.0)

    first = SceneScore(
        "1", "easy", (ViewScore(psnr=20.0), ViewScore(psnr=30.0)),
        tuple(geometry(r, d) for r, d in ((1.0, 0.1), (2.0, 0.2), (9.0, 0.3))), (4, 6, 8),
    )  # fmt: skip
    second = SceneScore("2", "hard", (ViewScore(psnr=10.0),), (geometry(4.0, 0.4),), (2,))
    figures = summarize([first, second])
    assert figures.psnr == pytest.approx(20.0)
    assert figures.rotation_deg == pytest.approx(3.0)
    assert figures.depth_rel == pytest.approx(0.3)
    assert figures.groups_used == pytest.approx(5.0)
    assert figures.direction_deg is figures.ap is figures.ssim is figures.masks_per_view is None
    assert (figures.counts["psnr"], figures.counts["rotation_deg"]) == (3, 4)
    assert figures.counts["ssim"] == figures.counts["ap"] == 0


def test_a_score_that_is_no_number_is_an_error_that_names_its_scene():
    def scene(**scores: float) -> SceneScore:
        return SceneScore("17", None, (ViewScore(psnr=20.0), ViewScore(**scores)))

    with pytest.raises(ValueError, match="psnr of scene 17 is nan"):
        summarize([scene(psnr=math.nan)])
    with pytest.raises(ValueError, match="lpips of scene 17 is inf"):
        summarize([scene(psnr=20.0, lpips=math.inf)])
    broken = GeometryScore(math.nan, None, None, None, None)
    with pytest.raises(ValueError, match="rotation_deg of scene 17 is nan"):
        summarize([SceneScore("17", None, (ViewScore(psnr=20.0),), (broken,))])


def test_scores_that_are_missing_are_counted_and_said(flat_sample):
    """Of two rooms one has no instance and no true depth: no AP of its own, no depth error."""
    empty = replace(
        flat_sample,
        context=replace(flat_sample.context, depths=torch.zeros_like(flat_sample.context.depths)),
        target_instances=torch.zeros_like(flat_sample.target_instances),
    )
    rooms = [ProtocolScene("1", "easy", (flat_sample,)), ProtocolScene("2", "hard", (empty,))]
    report = evaluate(
        oracle(flat_sample), rooms, protocol="rooms-2view", model_name="oracle"
    )  # fmt: skip
    counts = report.figures.counts
    assert (counts["psnr"], counts["ap"], counts["ap_scene_mean"]) == (2, 1, 1)
    assert (counts["rotation_deg"], counts["depth_rel"], counts["groups_used"]) == (2, 1, 2)
    text = as_table(report)
    assert "1 of 2 rooms have an instance that is asked for" in text
    assert "Known for 1 of 2 samples alone: depth_rel, depth_rel_unscaled, length_rel." in text
    details = as_json(report, details=True)["details"]
    assert details["figures"]["counts"]["depth_rel"] == 1
    assert details["levels"]["hard"]["ap"] is None


def test_where_nothing_is_missing_nothing_is_said_of_counts(report):
    assert report.figures.counts["psnr"] == report.figures.targets == 4
    assert " of 2 rooms have" not in as_table(report)
    assert "Known for" not in as_table(report)


def test_predicted_masks_take_the_colour_of_what_they_cover():
    true = np.array([[1, 1, 1, 2, 2, 0]])
    predicted = np.array([[5, 5, 3, 4, 4, -1]])
    # 5 covers instance 1, 4 covers 2; 3 also covers 1, which is taken by the larger mask: new.
    assert recolored(predicted, true).tolist() == [[1, 1, 3, 2, 2, 0]]


def test_a_sheet_has_a_row_for_contexts_and_one_for_each_target(tmp_path, flat_sample):
    prediction = predict(oracle(flat_sample), flat_sample, "given")
    write_sheet(tmp_path / "sheet.png", flat_sample, prediction, zoom=2)
    with Image.open(tmp_path / "sheet.png") as image:
        # Tiles of 32 pixels twice as large, gaps of 6, a title and a line of labels of 16.
        assert image.size == (6 + 4 * (64 + 6), 6 + 16 + (64 + 6) + (64 + 16 + 6))
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]


def test_lpips_is_measured_where_weights_are_and_its_network_is_named(flat_sample):
    torch.manual_seed(0)
    distance = Lpips("alexnet")
    room = ProtocolScene(name="1", level="easy", samples=(flat_sample,))
    report = evaluate(
        oracle(flat_sample), [room], protocol="rooms-2view", model_name="oracle", lpips=distance
    )
    assert report.figures.lpips is not None
    assert report.figures.lpips > 0
    assert "LPIPS is by alexnet" in as_table(report)
    photos = flat_sample.target.images[0]
    (score,) = score_views(flat_sample, photos, None, ApSettings(), lpips=distance)
    assert score.lpips == 0


def test_objects_are_measured_where_they_are_asked_for(report):
    assert report.figures.objects_per_instance is report.figures.purity is None
    assert "objects" not in as_json(report)
    rooms = FlatRooms(SEEDS[:1], ["easy"])
    asked = evaluate(
        knowing_model(rooms, targets=2),
        protocol_rooms(rooms, [0], "rooms-2view", targets_per_scene=2),
        EvaluationSettings(objects=True),
        protocol="rooms-2view",
        model_name="oracle",
    )
    found = as_json(asked)["objects"]
    assert list(found) == list(OBJECTS)
    assert (found["objects_per_instance"], found["whole_share"], found["found_share"]) == (1, 1, 1)
    assert found["small_found_share"] is None  # all three things are large
    assert "Objects in the context views: 6, 1.00 for each instance" in as_table(asked)
    row = results_rows(asked, command="c", commit="abc", seed=None, machine="m")
    head, line = results_header(asked).splitlines()
    assert head.count("|") == line.count("|") == row.count("|")


def test_figures_of_objects_by_hand():
    # 5 objects for 4 instances, 3 of them whole; 2 of 4 instances and 1 of 2 small ones are found.
    # 3 are fragments, one of these whole.
    first = ObjectScore(3, 2, 2, 1, 2, 1, 2, 1, (0.5, 0.7, 0.9), (4.0, 2.0, 2.0))
    second = ObjectScore(2, 2, 1, 1, 0, 0, 1, 0, (1.0, 0.4), (1.0, 1.0))
    scene = SceneScore("1", None, (ViewScore(psnr=20.0),), objects=(first, None, second))
    figures = summarize([scene])
    assert figures.objects_per_instance == pytest.approx(5 / 4)
    assert figures.whole_share == pytest.approx(3 / 5)
    assert figures.purity == pytest.approx(0.7)
    assert figures.purity_by_weight == pytest.approx((2.0 + 1.4 + 1.8 + 1.0 + 0.4) / 10)
    assert figures.found_share == pytest.approx(2 / 4)
    assert figures.small_found_share == pytest.approx(1 / 2)
    assert figures.fragment_share == pytest.approx(3 / 5)
    assert figures.listed_whole_share == pytest.approx(2 / 2)
    assert (figures.counts["objects"], figures.counts["small_instances"]) == (5, 2)
