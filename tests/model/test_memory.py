import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from instok3d.backbones import registry
from instok3d.backbones.cost import Activations, Outline, Work
from instok3d.backbones.depth_anything3 import DepthAnything3Config
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.registry import build_backbone
from instok3d.backbones.vggt import VGGTConfig
from instok3d.errors import NotEnoughMemoryError
from instok3d.model import available_memory, memory
from instok3d.model.memory import (
    check_memory,
    count_parameters,
    largest_view_count,
    predict_peak_bytes,
)
from instok3d.model.tokenizer import PAPER, Tokenizer, TokenizerConfig
from plane_backbone import PLANE, PlaneConfig

NANO = (NanoConfig(refinement_layers=0), TokenizerConfig())
"""What the sizes of training below were measured with."""
SHIPPED = (NanoConfig(), TokenizerConfig())
EIGHT = Work(views=8, height=128, width=128)


def bytes_for(**changes) -> int:
    return predict_peak_bytes(*NANO, replace(EIGHT, **changes))


def test_parameters_are_counted_without_being_made():
    model = Tokenizer(build_backbone(NANO[0]), NANO[1])
    own = sum(parameter.numel() for parameter in model.own_parameters())
    assert count_parameters(*NANO) == (sum(p.numel() for p in model.parameters()), own)


@pytest.mark.parametrize(
    ("views", "measured"),
    # Largest resident size of `instok3d reconstruct` on that many photos, one thread, bytes; the
    # larger of two runs, which were up to 5 % apart.
    [(1, 367e6), (2, 382e6), (8, 471e6), (16, 637e6)],
)
def test_the_prediction_is_never_below_what_was_measured_and_at_most_a_quarter_above(
    views: int, measured: float
):
    predicted = predict_peak_bytes(*SHIPPED, replace(EIGHT, views=views))
    assert measured <= predicted <= 1.25 * measured


@pytest.mark.parametrize(
    ("tokenizer", "batch", "views", "dtype", "measured"),
    # Largest resident size after three updates of the nano stages at 128 x 128, one thread, bytes.
    [
        (None, 4, 2, torch.float32, 1154e6),
        (None, 1, 8, torch.bfloat16, 1002e6),
        (NANO[1], 4, 2, torch.float32, 1114e6),
        (NANO[1], 1, 2, torch.float32, 703e6),
    ],
)
def test_so_it_is_for_training(tokenizer, batch: int, views: int, dtype, measured: float):
    work = Work(
        views, 128, 128, dtype=dtype, batch=batch, training=True, frozen_backbone=bool(tokenizer)
    )
    assert measured <= predict_peak_bytes(NANO[0], tokenizer, work) <= 1.25 * measured


@pytest.mark.parametrize(
    ("views", "side", "measured"), [(2, 224, 502e6), (8, 224, 720e6), (2, 448, 713e6)]
)
def test_so_it_is_for_depth_anything_3(views: int, side: int, measured: float):
    found = predict_peak_bytes(DepthAnything3Config("small"), None, Work(views, side, side))
    assert measured <= found <= 1.25 * measured


def test_more_of_anything_never_takes_less():
    for training in (False, True):
        counts = [bytes_for(views=views, training=training) for views in range(1, 40)]
        assert counts == sorted(counts)
        assert counts[-1] > counts[0]
        sizes = [bytes_for(height=side, width=side, training=training) for side in (64, 128, 256)]
        assert sizes == sorted(sizes)
        assert bytes_for(batch=4, training=training) > bytes_for(training=training)
    assert bytes_for(training=True) > bytes_for()
    frozen, free = (bytes_for(training=True, frozen_backbone=each) for each in (True, False))
    assert frozen < free
    assert bytes_for(training=True, cached_geometry=True) < frozen
    assert bytes_for(training=True, lpips=True) > frozen


def test_paper_sizes_take_gigabytes():
    from instok3d.backbones.vggt import PAPER_VGGT

    work = Work(2, 256, 256)
    whole, own = count_parameters(PAPER_VGGT, PAPER)
    assert whole - own == pytest.approx(1_190.6e6, rel=0.01)  # 1,256.5 M less the track head
    # Twice the weights while they are loaded: more than two views take.
    assert predict_peak_bytes(PAPER_VGGT, PAPER, work) == pytest.approx(8.4 * whole, rel=0.1)
    limit = 16_000_000_000
    few = largest_view_count(PAPER_VGGT, PAPER, work, limit)
    assert predict_peak_bytes(PAPER_VGGT, PAPER, replace(work, views=few)) <= limit
    assert predict_peak_bytes(PAPER_VGGT, PAPER, replace(work, views=few + 1)) > limit


def test_the_largest_count_is_the_last_that_fits():
    limit = bytes_for(views=11)
    assert largest_view_count(*NANO, EIGHT, limit) >= 11
    assert bytes_for(views=largest_view_count(*NANO, EIGHT, limit)) <= limit
    assert bytes_for(views=largest_view_count(*NANO, EIGHT, limit) + 1) > limit
    assert largest_view_count(*NANO, EIGHT, 1000) == 0
    assert largest_view_count(*NANO, EIGHT, 10**15) == memory.MOST_VIEWS


def with_free(monkeypatch: pytest.MonkeyPatch, free: int | None) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda device: free)
    monkeypatch.setattr(memory, "resident_bytes", lambda: 0)


def test_too_many_views_are_refused_with_the_count_that_fits(monkeypatch: pytest.MonkeyPatch):
    with_free(monkeypatch, bytes_for(views=10))
    with pytest.raises(NotEnoughMemoryError) as caught:
        check_memory(*NANO, replace(EIGHT, views=100), advice="take fewer")
    text = str(caught.value)
    assert text.startswith("100 views of 128 x 128 pixels are predicted to need 2.")
    fitting = int(text.split("; ")[1].split(" views would fit: take fewer")[0])
    assert fitting >= 10
    check_memory(*NANO, replace(EIGHT, views=fitting))
    with pytest.raises(NotEnoughMemoryError):
        check_memory(*NANO, replace(EIGHT, views=fitting + 1))
    with_free(monkeypatch, 1000)
    with pytest.raises(NotEnoughMemoryError, match="not even one view would fit"):
        check_memory(*NANO, EIGHT)


def test_nothing_is_refused_where_the_system_does_not_say(monkeypatch: pytest.MonkeyPatch):
    with_free(monkeypatch, None)
    assert check_memory(*NANO, EIGHT) == bytes_for()


def test_what_the_process_has_already_is_not_asked_for_again(monkeypatch: pytest.MonkeyPatch):
    with_free(monkeypatch, bytes_for() - 1_000_000)
    monkeypatch.setattr(memory, "resident_bytes", lambda: 1_000_000)
    check_memory(*NANO, EIGHT)


def test_a_backbone_whose_memory_nobody_counted_is_counted_without_it_and_said(plane, monkeypatch):
    config, work = PlaneConfig(channels=8), Work(2, 64, 64)
    with pytest.warns(UserWarning, match="memory a PlaneBackbone takes .* is not known"):
        activations = memory.backbone_activations(config, work)
    # 2 x 8 x 8 patches of 8 channels; 12 numbers a pixel of depths, confidences and points.
    assert activations.result == 4 * (2 * 64 * 8 + 12 * 2 * 64 * 64)
    assert activations.peak == activations.stored == 0
    with_free(monkeypatch, 10**12)
    with pytest.warns(UserWarning, match="is not known"):
        assert check_memory(config, NANO[1], work) > memory.PROCESS_BYTES
    with_free(monkeypatch, 1000)
    with (
        pytest.warns(UserWarning, match="is not known"),
        pytest.raises(NotEnoughMemoryError, match="not even one view"),
    ):
        check_memory(config, NANO[1], work)


def test_a_backbone_says_its_own_memory(monkeypatch):
    config, work = PlaneConfig(channels=8), Work(2, 64, 64)
    kind = replace(
        PLANE,
        activations=lambda config, work: Activations(10**9, 0, config.channels),
        outline=lambda config: Outline(5_000, config.patch_size, config.channels),
    )
    monkeypatch.setattr(registry, "_REGISTERED", {})
    registry.register_backbone("counted", kind)
    assert memory.backbone_activations(config, work) == Activations(10**9, 0, 8)
    assert memory._outline.__wrapped__(config).numbers == 5_000


def test_bf16_keeps_narrow_copies_of_the_weights():
    whole, _ = count_parameters(*NANO)
    wide, narrow = (bytes_for(views=64, dtype=each) for each in (torch.float32, torch.bfloat16))
    assert narrow - wide == 2 * whole


def test_free_memory_is_the_least_of_machine_and_control_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal: 9 kB\nMemAvailable:    4000 kB\n")
    monkeypatch.setattr(available_memory, "MEMINFO", meminfo)
    monkeypatch.setattr(available_memory, "CGROUP", tmp_path)
    assert available_memory.available_bytes() == 4_096_000
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("900000\n")
    assert available_memory.available_bytes() == 4_096_000
    (tmp_path / "memory.max").write_text("1000000\n")
    assert available_memory.available_bytes() == 100_000
    (tmp_path / "memory.stat").write_text("anon 5\ninactive_file 50000\n")
    assert available_memory.available_bytes() == 150_000
    meminfo.write_text("MemAvailable: 100 kB\n")
    assert available_memory.available_bytes() == 102_400
    (tmp_path / "memory.max").unlink()
    (tmp_path / "memory").mkdir()
    (tmp_path / "memory" / "memory.limit_in_bytes").write_text(str(2**63 - 4096))
    (tmp_path / "memory" / "memory.usage_in_bytes").write_text("1")
    assert available_memory.available_bytes() == 102_400


def test_this_process_has_memory():
    assert available_memory.resident_bytes() > 50e6
    assert available_memory.available_bytes() > 0


def test_a_backbone_that_runs_first_counts_beside_the_weights_of_the_model(monkeypatch):
    """The larger need is refused, and the count that is named fits both."""
    first = (VGGTConfig(), Work(8, 518, 518))
    small = (NANO[0], replace(EIGHT, height=16, width=16))
    monkeypatch.setattr(memory, "resident_bytes", lambda: 0)
    monkeypatch.setattr(memory, "available_bytes", lambda device: None)
    alone = check_memory(first[0], None, first[1])
    weights = 4 * memory.count_parameters(*NANO)[0]
    assert check_memory(*NANO, EIGHT, first=first) == alone + weights
    assert check_memory(*NANO, EIGHT, first=small) == check_memory(*NANO, EIGHT)
    monkeypatch.setattr(memory, "available_bytes", lambda device: alone + weights - 1)
    with pytest.raises(NotEnoughMemoryError, match="8 views of 518 x 518") as caught:
        check_memory(*NANO, EIGHT, first=first)
    fitting = int(re.search(r"(\d+) views? would fit", str(caught.value))[1])
    work = replace(EIGHT, views=fitting)
    check_memory(*NANO, work, first=(first[0], replace(first[1], views=fitting)))
