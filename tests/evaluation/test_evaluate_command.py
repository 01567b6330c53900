import json
from pathlib import Path

import numpy as np
import pytest
import torch

from capture_folders import write_capture, write_outlines
from flat_rooms import flat_room
from instok3d.backbones.nano.backbone import NanoBackbone, NanoConfig
from instok3d.baselines.feature_files import save_feature_model
from instok3d.baselines.query_gaussians import QueryGaussianConfig, QueryGaussians
from instok3d.baselines.segmenter import Segmenter, SegmenterConfig
from instok3d.baselines.segmenter_file import save_segmenter
from instok3d.cli import main
from instok3d.datasets.prepared import PreparedFrame, SceneInfo, refresh_index, write_scene
from instok3d.evaluation.figures import OBJECTS
from instok3d.evaluation.report import KEYS
from instok3d.files import sha256_of, write_json
from instok3d.model.files import load_model, save_model
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.rooms.scene import RenderedScene
from instok3d.rooms.shards import ShardRecord, add_to_index, new_index, write_shard
from instok3d.semantics.predictor import PredictorConfig

SEED = 2_000_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two test rooms, one rejected seed between them, and an untrained model."""
    folder = tmp_path_factory.mktemp("rooms")
    write_json(folder / "rooms.json", new_index(32, "mix"))
    rooms = [flat_room(SEED, "easy"), flat_room(SEED + 2, "hard")]
    scenes = [
        RenderedScene(
            images=room.images,
            instances=room.instances.astype(np.uint16),
            depths_mm=(room.depths_m * 1000).astype(np.uint16),
            world_from_cam=room.world_from_cam.astype(np.float32),
            intrinsics=room.intrinsics.astype(np.float32),
            meta=room.meta,
        )
        for room in rooms
    ]
    write_shard(folder / "rooms-2000000.safetensors", scenes)
    add_to_index(folder, SEED // 16, ShardRecord([SEED, SEED + 2], [SEED + 1], ["easy", "hard"]))
    torch.manual_seed(0)
    backbone = NanoBackbone(NanoConfig(width=64, layers=1))
    sizes = TokenizerConfig(width=64, num_anchors=16, num_groups=4, anchor_layers=1, group_layers=1)
    save_model(
        Tokenizer(backbone, sizes), folder / "tiny.safetensors", card={"config": {"seed": 7}}
    )
    return folder


def prepare_flat_room(folder: Path) -> None:
    """The flat room as a prepared test scene of ScanNet."""
    room = flat_room()
    frames = [
        PreparedFrame(
            source=str(k),
            image=room.images[k],
            world_from_cam=room.world_from_cam[k].astype(np.float64),
            intrinsics=room.intrinsics[k].astype(np.float64),
            depth_thousandths=(room.depths_m[k] * 1000).astype(np.uint16),
            instances=room.instances[k].astype(np.uint16),
        )
        for k in range(16)
    ]
    write_scene(folder, SceneInfo("a", "scannet", "test", "metre"), frames)
    refresh_index(folder)


def command(folder: Path, *more: str) -> list[str]:
    words = ["evaluate", "rooms-2view", "--data", str(folder), "--scenes", "2"]
    return [*words, "--model", str(folder / "tiny.safetensors"), *more]


def test_json_on_stdout_is_one_object_with_the_agreed_keys(folder, capsys):
    assert main(command(folder, "--json", "--targets-per-scene", "1")) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) == {"protocol", "model", "scenes", *KEYS}
    assert result["scenes"] == 2
    assert result["lpips"] is None
    assert result["rotation_deg"] is not None
    assert result["model"].startswith("tiny.safetensors sha256:")


def test_groups_are_cleaned_and_objects_counted_if_that_is_asked_for(folder, capsys):
    words = command(folder, "--scenes", "1", "--targets-per-scene", "1", "--clean-up", "--objects")
    assert main([*words, "--json", "--details"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result["objects"]) == set(OBJECTS)
    assert result["details"]["settings"]["clean_up"] is True
    assert main([*words, "--markdown"]) == 0
    text = capsys.readouterr().out
    assert ", cleaned up |" in text
    assert "| objects per instance | whole | purity |" in text


def test_the_report_says_how_photos_were_disturbed(folder, capsys):
    words = command(folder, "--scenes", "1", "--targets-per-scene", "1", "--disturb")
    assert main([*words, "grey"]) == 0
    assert "The context photos were disturbed: grey." in capsys.readouterr().out
    assert main([*words, "focal2", "--markdown"]) == 0
    assert ", photos disturbed: focal2 |" in capsys.readouterr().out


def test_the_model_sees_the_photos_at_the_size_that_is_asked_for(folder, capsys):
    words = command(folder, "--scenes", "1", "--targets-per-scene", "1")
    assert main([*words, "--pixels", "64"]) == 0
    assert "The model saw the photos at 64 pixels." in capsys.readouterr().out
    assert main([*words, "--pixels", "72", "--markdown"]) == 0
    assert ", photos of 72 pixels |" in capsys.readouterr().out
    for pixels, message in (("70", "needs multiples of 8"), ("0", "--pixels must lie in 64..512")):
        assert main([*words, "--pixels", pixels]) == 2
        assert message in capsys.readouterr().err
    assert main([*words, "--frame-pixels", "64"]) == 2
    assert "--frame-pixels is of captures" in capsys.readouterr().err


def test_given_geometry_leaves_its_errors_null(folder, capsys):
    assert main(command(folder, "--json", "--geometry", "given", "--targets-per-scene", "1")) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["rotation_deg"] is result["depth_rel"] is None


@pytest.mark.parametrize(("unit", "true_targets"), [("metre", 1), (None, 0)])
def test_the_papers_protocols_tell_intrinsics_and_render_at_true_cameras_in_their_unit(
    folder, tmp_path, capsys, unit, true_targets
):
    prepare_flat_room(tmp_path)
    model = load_model(folder / "tiny.safetensors")
    save_model(model, tmp_path / "model.safetensors", card={"unit": unit})
    words = ["evaluate", "scannet-2view", "--data", str(tmp_path), "--json", "--details"]
    assert main([*words, "--model", str(tmp_path / "model.safetensors")]) == 0
    details = json.loads(capsys.readouterr().out)["details"]
    assert details["settings"]["geometry"] == "intrinsics"
    assert details["settings"]["target_cameras"] == "auto"
    assert details["true_targets"] == true_targets


def test_a_unit_that_nobody_knows_is_refused(folder, tmp_path, capsys):
    model = load_model(folder / "tiny.safetensors")
    save_model(model, tmp_path / "model.safetensors", card={"unit": "feet"})
    assert main(command(folder, "--model", str(tmp_path / "model.safetensors"))) == 2
    assert "its unit is 'feet'; wanted one of metre, baseline" in capsys.readouterr().err


def test_pictures_are_saved_for_every_sample(folder, tmp_path, capsys):
    words = ["--targets-per-scene", "2", "--save", str(tmp_path / "sheets"), "--markdown"]
    assert main(command(folder, *words)) == 0
    assert len(list((tmp_path / "sheets").glob("rooms-2view_*.png"))) == 4
    assert "| 7 |" in capsys.readouterr().out  # the seed of the model's card


@pytest.mark.parametrize(
    ("more", "code", "message"),
    [
        (["--scenes", "3"], 2, "no room with seed 2000003"),
        (["--data", "/nowhere"], 2, "instok3d data rooms"),
        (["--model", "/nowhere.safetensors"], 4, "no model file"),
        (["--pose-alignment-steps", "-1"], 2, "0 or more, got -1"),
        (["--details"], 2, "pass --json too"),
        (["--lpips", "/nowhere"], 2, "no LPIPS weights"),
    ],
)
def test_bad_input_is_one_sentence_and_an_exit_code(folder, capsys, more, code, message):
    assert main(command(folder, *more)) == code
    said = capsys.readouterr()
    assert message in said.err
    assert said.out == ""


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> Path:
    """A capture of 15 frames with metric depth and one of 3 without depth."""
    folder = tmp_path_factory.mktemp("captures")
    write_capture(folder / "long", 15)
    write_capture(folder / "short", 3, depth=False)
    return folder


def capture_command(model: Path, data: Path, *more: str) -> list[str]:
    words = ["evaluate", "capture", "--data", str(data), "--targets-per-scene", "2"]
    return [*words, "--model", str(model / "tiny.safetensors"), *more]


def test_captures_are_measured_by_both_protocols(folder, captures, capsys):
    # Given cameras, because those of eight views take long to predict.
    more = ["--json", "--pose-alignment-steps", "0", "--geometry", "given"]
    with pytest.warns(UserWarning, match=r"1 of 2 captures have fewer than the 15 frames .*short"):
        assert main(capture_command(folder, captures, *more)) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) == {"protocol", "capture-2view", "capture-8view"}
    two, eight = result["capture-2view"], result["capture-8view"]
    beside = {"id_agreement", "targets", "outlined_targets", "aligned", "captures"}
    assert set(two) == set(eight) == {"protocol", "model", "scenes", *KEYS, *beside}
    assert (two["scenes"], two["targets"], two["outlined_targets"]) == (2, 3, 0)
    assert (eight["scenes"], eight["targets"], eight["outlined_targets"]) == (1, 7, 0)
    assert eight["ap"] is eight["aligned"] is None
    assert set(eight["captures"]) == {"long"}


def test_outlines_and_aligned_targets_of_captures(folder, captures, tmp_path, capsys):
    outlines = write_outlines(
        tmp_path / "outlines", captures / "long/color/4.png", {"wall": [[0, 0], [32, 0], [32, 32]]}
    )
    more = ["--json", "--pose-alignment-steps", "1", "--save", str(tmp_path / "sheets")]
    words = capture_command(folder, captures, *more, "--outlines", str(outlines.parent))
    words[1] = "capture-2view"
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["outlined_targets"] == 1
    assert result["ap"] is not None
    long, short = result["captures"]["long"], result["captures"]["short"]
    assert short["ap"] is short["depth_rel"] is None
    assert long["rotation_deg"] is not None
    assert short["id_agreement"] is not None
    assert result["aligned"]["steps"] == 1
    assert result["aligned"]["psnr"] != result["psnr"]
    assert {path.name for path in (tmp_path / "sheets").iterdir()} == {
        "capture-2view_long.png", "capture-2view_short.png",
    }  # fmt: skip


def test_a_table_and_rows_of_a_capture_have_both_kinds_of_targets(folder, captures, capsys):
    words = capture_command(folder, captures / "short", "--pose-alignment-steps", "1")
    words[1] = "capture-2view"
    assert main(words) == 0
    table = capsys.readouterr().out
    assert "all scenes, aligned" in table
    assert "0 of 1 target views have outlines" in table
    assert "No true depth is known" in table
    assert main([*words, "--markdown"]) == 0
    head, _, placed, aligned = capsys.readouterr().out.splitlines()
    assert "| same id |" in head
    assert "| predicted |" in placed
    assert "| predicted, targets aligned in 1 steps |" in aligned
    assert head.count("|") == placed.count("|") == aligned.count("|")


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--outlines", "/nowhere"], "no folder of outlines /nowhere"),
        (["--frame-step", "0"], "--frame-step must be at least 1, got 0"),
        (["--targets-per-scene", "0"], "--targets-per-scene must be at least 1, got 0"),
        (["--frame-step", "20"], "can be measured by capture"),
        (["--data", "/nowhere"], "there is no folder /nowhere"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*have fewer than")
def test_what_captures_cannot_be_asked_for_is_said(folder, captures, capsys, more, message):
    assert main(capture_command(folder, captures, *more)) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert said.out == ""


def test_what_one_protocol_cannot_use_does_not_cost_the_figures_of_the_other(
    folder, tmp_path, capsys
):
    write_capture(tmp_path / "sound", 3)
    broken = write_capture(tmp_path / "broken", 15) / "color/7.png"
    broken.write_bytes(broken.read_bytes()[:300])
    # Two views of two targets do not see the photo that is cut off, eight views do.
    words = capture_command(folder, tmp_path, "--json", "--pose-alignment-steps", "0")
    with pytest.warns(UserWarning, match=r"capture broken is left out: .*7\.png"):
        assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) == {"protocol", "capture-2view"}
    assert set(result["capture-2view"]["captures"]) == {"broken", "sound"}
    words[1] = "capture-8view"
    with pytest.warns(UserWarning, match="have fewer than the 15 frames"):
        assert main(words) == 2
    assert "can be measured by capture-8view" in capsys.readouterr().err
    assert main([*words, "--data", str(broken.parents[1])]) == 2
    assert "7.png is damaged" in capsys.readouterr().err


def test_outlines_are_for_captures_alone(folder, tmp_path, capsys):
    assert main(command(folder, "--outlines", str(tmp_path))) == 2
    assert "--outlines are of photos of captures, rooms-2view has" in capsys.readouterr().err


def by_method(folder: Path, *more: str) -> list[str]:
    words = ["evaluate", "rooms-8view", "--data", str(folder), "--scenes", "1"]
    return [*words, "--method-steps", "12", *more]


def test_other_methods_are_measured_by_the_same_protocols(folder, tmp_path, capsys):
    words = by_method(folder, "--method", "objectgs", "--save", str(tmp_path))
    assert main([*words, "--json", "--details"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["model"] == "objectgs, 12 steps, masks true, tracker true-ids"
    assert result["psnr"] is not None
    assert result["ap25"] > 0.3
    assert result["rotation_deg"] is None
    assert result["details"]["settings"]["geometry"] == "given"
    assert len(list(tmp_path.iterdir())) == 1
    assert main(by_method(folder, "--method", "3dgs", "--markdown")) == 0
    row = capsys.readouterr().out.splitlines()[-1]
    assert "| given | 3dgs, 12 steps | 1 | 7 |" in row


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--method", "3dgs", "--refine", "5"], "--refine is of the tokenizer; leave it out"),
        (["--method", "3dgs", "--geometry", "predicted"], "--geometry is of the tokenizer"),
        ([], "add --method"),
        (
            ["--masks", "degraded"],
            "--masks and --tracker are of a method that optimises each scene",
        ),
        (["--method", "3dgs", "--masks", "true"], "--method 3dgs needs no masks"),
        (
            ["--method", "objectgs", "--masks", "degraded", "--tracker", "true-ids"],
            "choose --tracker true-depth",
        ),
        (
            ["--method", "c3g-style", "--model", "mine"],
            "--masks and --tracker are of a method that optimises",
        ),
        (["--method", "objectgs", "--masks", "segmenter:"], "or segmenter:FILE, got 'segmenter:'"),
        (["--method", "objectgs", "--model", "mine"], "--model is of the tokenizer"),
    ],
)
def test_options_of_other_methods_are_checked(folder, capsys, words, message):
    assert main(by_method(folder, *words)) == 2
    assert message in capsys.readouterr().err


def test_the_row_names_where_masks_and_their_ids_come_from(folder, capsys):
    words = by_method(folder, "--method", "label-lifting", "--json", "--masks", "degraded")
    assert main(words) == 0
    name = json.loads(capsys.readouterr().out)["model"]
    assert name == "label-lifting, 12 steps, masks degraded, tracker true-depth"
    model = str(folder / "tiny.safetensors")
    assert main([*words, "--tracker", "predicted-depth", "--model", model]) == 0
    assert json.loads(capsys.readouterr().out)["model"].endswith(
        "masks degraded, tracker predicted-depth of tiny.safetensors"
    )


def test_a_segmenter_gives_masks_and_is_named_with_its_hash(folder, tmp_path, capsys):
    file = tmp_path / "masks.safetensors"
    sizes = PredictorConfig(16, 16, 1, 16, quarter_channels=16, half_channels=16)
    torch.manual_seed(0)
    save_segmenter(Segmenter(SegmenterConfig(sizes, 4, 1)), file, card={})
    words = by_method(folder, "--method", "label-lifting", "--json", "--masks", f"segmenter:{file}")
    model = ["--model", str(folder / "tiny.safetensors")]
    assert main([*words, *model]) == 0
    given = f"masks segmenter masks.safetensors sha256:{sha256_of(file)[:12]}"
    name = json.loads(capsys.readouterr().out)["model"]
    assert name.endswith(f"{given}, tracker predicted-depth of tiny.safetensors")
    assert main([*words, *model, "--tracker", "flow2d"]) == 2
    assert "--model is of the tokenizer" in capsys.readouterr().err
    assert main([*words[:-1], "segmenter:/none"]) == 4
    assert "no segmenter /none; train one" in capsys.readouterr().err


def test_a_model_of_one_pass_is_measured_from_bare_photos(folder, tmp_path, capsys):
    file = tmp_path / "queries.safetensors"
    torch.manual_seed(0)
    sizes = QueryGaussianConfig(20, 16, 1, head_size=16, encoder_channels=4)
    model = QueryGaussians(NanoBackbone(NanoConfig(width=64, layers=1)), sizes)
    save_feature_model(model, file, card={})
    words = ["evaluate", "rooms-2view", "--data", str(folder), "--scenes", "1", "--method"]
    assert main([*words, "c3g-style", "--model", str(file), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["model"] == f"c3g-style queries.safetensors sha256:{sha256_of(file)[:12]}"
    assert result["psnr"] is not None
    assert result["rotation_deg"] is not None
    assert result["ap"] is None
    for more, told in (
        (["c3g-style"], "needs --model FILE: instok3d train nano-c3g-style"),
        (["c3g-style", "--model", str(file), "--refine", "3"], "--refine is of the tokenizer"),
        (["uni3r-style", "--model", str(file)], "holds a model of c3g-style, wanted is one of"),
    ):
        assert main([*words, *more]) == 2
        assert told in capsys.readouterr().err


def test_instances_in_space_are_measured_if_that_is_asked_for(folder, capsys):
    words = by_method(folder, "--method", "objectgs", "--instances-3d")
    assert main([*words, "--json", "--details"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result["instances_3d"]) == {"ap_3d", "ap50_3d", "ap25_3d"}
    assert result["instances_3d"]["ap50_3d"] > 0.5
    figures = result["details"]["figures"]
    assert figures["label_scalars"] == figures["semantic_units"] < figures["gaussians"]
    assert figures["ap_scannet"] >= result["ap"]
    assert main([*words, "--markdown"]) == 0
    assert "| AP 3D | AP50 3D | AP25 3D |" in capsys.readouterr().out


def test_costs_are_stated_if_that_is_asked_for(folder, capsys):
    words = by_method(folder, "--method", "3dgs", "--costs")
    assert main([*words, "--json"]) == 0
    costs = json.loads(capsys.readouterr().out)["costs"]
    assert set(costs) == {"gaussians", "semantic_units", "label_scalars", "feature_scalars",
                          "fit_s", "picture_s", "peak_mb"}  # fmt: skip
    if Path("/proc/self/clear_refs").exists():
        assert costs["peak_mb"] > 100  # Python and PyTorch alone are more
    assert main([*words, "--markdown"]) == 0
    head, line, row = capsys.readouterr().out.splitlines()[:3]
    assert "| scene (s) | picture (s) | peak (MB) |" in head
    assert head.count("|") == line.count("|") == row.count("|")


def test_methods_that_need_depth_are_refused_for_captures(folder, capsys):
    words = ["evaluate", "capture", "--data", str(folder), "--method", "3dgs"]
    assert main(words) == 2
    assert "choose a protocol of rooms or ScanNet" in capsys.readouterr().err
