import json

import numpy as np
import torch
from PIL import Image

from instok3d.training.pictures import color_picture, contact_sheet, depth_picture, id_picture
from instok3d.training.plots import COLORS, plot_curves
from instok3d.training.run_log import RunLog, format_duration, read_metrics


def test_sheet_enlarges_by_a_whole_factor_and_keeps_colours():
    red = np.full((10, 20, 3), (255, 0, 0), np.uint8)
    sheet = contact_sheet([[red, red], [red]], ["one", "two"], min_cell=25)
    # 10 rows become 30, 20 columns 60; gaps of 4 around, a line of titles of 14 on top.
    assert sheet.size == (2 * 64 + 4, 2 * 34 + 4 + 14)
    assert sheet.getpixel((40, 60)) == (255, 0, 0)
    assert sheet.getpixel((100, 60)) == (255, 255, 255)


def test_void_is_black_and_ids_differ():
    picture = id_picture(torch.tensor([[0, 1, 2], [3, 40, -1]]))
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[1, 2].tolist() == [64, 64, 64]
    assert len({tuple(p) for p in picture.reshape(-1, 3).tolist()}) == 6
    assert not id_picture(torch.zeros(2, 2, dtype=torch.long)).any()


def test_pictures_are_cut_to_bytes():
    image = torch.tensor([-1.0, 0.5, 2.0]).view(1, 1, 3).expand(3, 1, 3)
    assert color_picture(image)[0, :, 0].tolist() == [0, 128, 255]
    depths = torch.tensor([[0.0, 1.0, 2.0, 9.0]])
    assert depth_picture(depths, farthest=2.0)[0, :, 0].tolist() == [0, 128, 0, 0]


def test_curves_show_training_and_validation(tmp_path):
    lines = [{"kind": "train", "step": k, "elapsed_s": 0, "loss": 1 / (k + 1)} for k in range(9)]
    lines += [{"kind": "validation", "step": 4, "elapsed_s": 0, "loss": 0.5}]
    metrics = tmp_path / "metrics.jsonl"
    metrics.write_text("".join(json.dumps(line) + "\n" for line in lines))
    plot_curves(metrics, tmp_path / "curves.png")
    with Image.open(tmp_path / "curves.png") as picture:
        seen = {color for _, color in picture.convert("RGB").getcolors(10_000)}
    assert set(COLORS.values()) <= seen


def test_no_metrics_give_an_empty_picture(tmp_path):
    plot_curves(tmp_path / "metrics.jsonl", tmp_path / "curves.png")
    assert (tmp_path / "curves.png").is_file()


def test_cut_last_line_of_the_metrics_is_left_out(tmp_path):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"step": 1}\n{"step": 2}\n{"st')
    assert [line["step"] for line in read_metrics(path)] == [1, 2]


def test_figure_that_is_not_a_number_is_left_out(tmp_path):
    RunLog(tmp_path, total_steps=2).validation(1, 0.5, {"ap": float("nan"), "psnr": 20.0})
    (line,) = read_metrics(tmp_path / "metrics.jsonl")
    assert line == {"kind": "validation", "step": 1, "elapsed_s": 0.5, "psnr": 20.0}


def test_a_resumed_record_has_each_line_once(tmp_path):
    log = RunLog(tmp_path, total_steps=9)
    for step in (2, 4):
        log.train(step, 1.0, {"loss": float(step)})
    log.validation(3, 1.0, {"psnr": 1.0})
    resumed = RunLog(tmp_path, total_steps=9, first_step=3, resumed=True)
    resumed.validation(3, 2.0, {"psnr": 1.0})
    resumed.train(4, 2.0, {"loss": 4.0})
    lines = read_metrics(tmp_path / "metrics.jsonl")
    assert [(line["kind"], line["step"]) for line in lines] == [
        ("train", 2), ("validation", 3), ("train", 4),
    ]  # fmt: skip
    RunLog(tmp_path, total_steps=9)  # a run that begins anew
    assert read_metrics(tmp_path / "metrics.jsonl") == []


def test_a_silent_record_writes_and_prints_nothing(tmp_path, capsys):
    RunLog(None, total_steps=2).train(1, 0.5, {"loss": 1.0})
    assert capsys.readouterr().err == ""
    assert list(tmp_path.iterdir()) == []


def test_durations_read_well():
    assert format_duration(59.9) == "0m59s"
    assert format_duration(7261.0) == "2h01m"
