import json

from PIL import Image

from instok3d.training.plots import COLORS, plot_curves
from instok3d.training.run_log import RunLog, read_metrics


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
    path.write_text('{"kind": "train", "step": 1}\n{"kind": "train", "step": 2}\n{"kind": "tr')
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
