"""SAM 2 itself, tiny and random: what goes in and comes out, not how good it is."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from mutations import limits, of_json, of_safetensors, survive
from tiny_sam2 import SIDE, write_tiny_sam2

pytest.importorskip("transformers", reason="SAM 2 needs transformers: pip install instok3d[models]")

from instok3d.datasets.pseudo_labels.association import AssociationConfig, label_clip
from instok3d.datasets.pseudo_labels.automatic import AutomaticConfig
from instok3d.datasets.pseudo_labels.sam2 import Sam2, mask_prompt, prepared

ALL = AutomaticConfig(
    points_per_side=2, min_predicted_iou=-1e9, min_stability=0.0, max_overlap=0.95
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_sam2(tmp_path_factory.mktemp("sam2"))


@pytest.fixture(scope="module")
def sam2(folder: Path) -> Sam2:
    return Sam2(folder, ALL)


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (9, 40, 56, 3)).astype(np.uint8)


def box() -> np.ndarray:
    mask = np.zeros((40, 56), dtype=bool)
    mask[8:24, 12:40] = True
    return mask


def test_a_clip_is_labelled_end_to_end_and_the_same_each_time(sam2, frames):
    config = AssociationConfig(keyframe_step=2)
    maps = np.stack(list(label_clip(frames[:4], sam2, sam2, config)))
    assert maps.shape == (4, 40, 56)
    assert maps.any()
    again = np.stack(list(label_clip(frames[:4], sam2, sam2, config)))
    np.testing.assert_array_equal(again, maps)


def test_a_track_takes_its_prompt_for_the_truth_and_is_tracked_on(sam2, frames):
    session = sam2.start()
    assert session.step(frames[0]) == {}
    session.add({5: box(), 9: box()})
    found = session.step(frames[1])
    assert found.keys() == {5, 9}
    assert found[5].mask.shape == (40, 56)
    assert 0 < found[5].score < 1
    np.testing.assert_array_equal(found[5].mask, found[9].mask)
    session.forget([9, 77])
    assert session.step(frames[2]).keys() == {5}


def test_what_is_thrown_away_was_not_needed(sam2, frames):
    """Twin: the same frames through transformers' own session, which keeps everything."""
    from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

    video = torch.cat([prepared(frame, SIDE, torch.device("cpu")) for frame in frames])
    whole = Sam2VideoInferenceSession(video, 40, 56, dtype=torch.float32)
    whole.obj_id_to_idx(5)
    whole.add_mask_inputs(0, 0, mask_prompt(box(), SIDE))
    whole.obj_with_new_inputs = [5]
    ours = sam2.start()
    ours.step(frames[0])
    ours.add({5: box()})
    sam2._video(whole, frame_idx=0)
    for number in range(1, len(frames)):  # longer than both memories, of 3 and 4 frames
        theirs = sam2._video(whole, frame_idx=number)
        found = ours.step(frames[number])[5]
        assert found.score == pytest.approx(float(theirs.object_score_logits.sigmoid()), abs=1e-6)
        logits = ours._tracks[5].output_dict_per_obj[0]["non_cond_frame_outputs"][number]
        torch.testing.assert_close(logits["pred_masks"], theirs.pred_masks, atol=1e-4, rtol=1e-4)
    kept = ours._tracks[5].output_dict_per_obj[0]["non_cond_frame_outputs"]
    assert sorted(kept) == [5, 6, 7, 8]
    assert [k for k in sorted(kept) if "maskmem_features" in kept[k]] == [6, 7, 8]
    assert len(ours._tracks[5].processed_frames) == 1


def test_pictures_are_stretched_and_normalised():
    image = np.zeros((10, 20, 3), dtype=np.uint8)
    image[:, :, 0], image[:, :, 1], image[:, :, 2] = 255, 0, 51
    pixels = prepared(image, 8, torch.device("cpu"))
    assert pixels.shape == (1, 3, 8, 8)
    # (1 - 0.485) / 0.229, (0 - 0.456) / 0.224, (0.2 - 0.406) / 0.225
    expected = torch.tensor([2.248908, -2.035714, -0.915556])
    torch.testing.assert_close(pixels[0, :, 3, 5], expected, atol=1e-5, rtol=0)


def test_prompts_keep_masks_that_are_thinner_than_a_cell():
    mask = np.zeros((64, 64), dtype=bool)
    mask[:32] = True
    half = mask_prompt(mask, 16)
    assert half.shape == (1, 1, 16, 16)
    assert half[0, 0, :8].all()
    assert not half[0, 0, 8:].any()
    line = np.zeros((64, 64), dtype=bool)
    line[9] = True
    assert mask_prompt(line, 16).any()
    assert not mask_prompt(np.zeros((64, 64), dtype=bool), 16).any()


def test_the_identity_names_weights_library_and_settings(sam2, folder):
    import hashlib

    identity = sam2.identity()
    sha256 = hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()
    assert identity["weights_sha256"] == sha256
    assert re.fullmatch(r"transformers \d+\.\d+\.\d+.*", identity["library"])
    assert identity["automatic"]["points_per_side"] == 2
    json.dumps(identity)


def test_folders_that_hold_no_sam2_are_refused(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no config\.json in"):
        Sam2(tmp_path)
    config = json.loads((folder / "config.json").read_text())
    (tmp_path / "model.safetensors").write_bytes(b"no weights")
    (tmp_path / "config.json").write_text(json.dumps(config | {"model_type": "clip"}))
    with pytest.raises(ValueError, match="of the model type 'clip', not 'sam2_video'"):
        Sam2(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(ValueError, match="cannot be read as SAM 2"):
        Sam2(tmp_path)


def copied(folder: Path, place: Path) -> Path:
    for name in ("config.json", "model.safetensors"):
        (place / name).write_bytes((folder / name).read_bytes())
    return place


def test_any_damage_of_the_config_is_refused_or_read(folder, tmp_path):
    copied(folder, tmp_path)
    assert survive(tmp_path / "config.json", lambda: Sam2(tmp_path), of_json, 15)


def test_any_damage_of_the_weights_is_refused_or_read(folder, tmp_path):
    copied(folder, tmp_path)
    assert survive(tmp_path / "model.safetensors", lambda: Sam2(tmp_path), of_safetensors, 8)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"null", b"[]", b"3", b'{"model_type": null}', b"\xff\xfe{}", b"[" * 100_000,
     b'{"model_type": NaN}', b'{"model_type": ["sam2_video"]}'],
)  # fmt: skip
def test_a_config_that_is_none_is_refused_in_one_sentence(folder, tmp_path, content):
    copied(folder, tmp_path)
    (tmp_path / "config.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"config\.json is (damaged|of the model type)") as error:
        Sam2(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors")
def test_sizes_that_the_weights_do_not_have_are_refused_in_one_sentence(folder, tmp_path):
    copied(folder, tmp_path)
    config = json.loads((folder / "config.json").read_text())
    for value in (-1, 0, 64, "x", None, 2**40):
        changed = config | {"memory_attention_feed_forward_hidden_size": value}
        (tmp_path / "config.json").write_text(json.dumps(changed))
        with limits(), pytest.raises(ValueError, match=r"model\.safetensors") as error:
            Sam2(tmp_path)
        assert "\n" not in str(error.value)


def test_missing_weights_are_named(folder, tmp_path):
    from safetensors.torch import load_file, save_file

    weights = load_file(folder / "model.safetensors")
    del weights["memory_encoder.projection.weight"]
    save_file(weights, tmp_path / "model.safetensors", metadata={"format": "pt"})
    (tmp_path / "config.json").write_text((folder / "config.json").read_text())
    with pytest.raises(ValueError, match=r"lacks 1 weights .* memory_encoder\.projection\.weight"):
        Sam2(tmp_path)


def test_weights_that_are_not_finite_are_refused(folder, tmp_path, frames):
    from safetensors.torch import load_file, save_file

    weights = load_file(folder / "model.safetensors")
    weights["object_pointer_proj.proj_out.bias"].fill_(float("nan"))
    save_file(weights, tmp_path / "model.safetensors", metadata={"format": "pt"})
    (tmp_path / "config.json").write_text((folder / "config.json").read_text())
    session = Sam2(tmp_path).start()
    session.step(frames[0])
    session.add({1: box()})
    with pytest.raises(ValueError, match="frame 1 with values that are not finite"):
        session.step(frames[1])


def test_without_transformers_the_error_says_what_to_install(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'instok3d\[models\]'"):
        Sam2(folder)
