from dataclasses import replace

import pytest

from instok3d.errors import NotEnoughMemoryError
from instok3d.model import memory
from instok3d.training.config import preset
from instok3d.training.cost.estimate import (
    check_memory,
    flop_per_sample,
    model_on_paper,
    training_memory_bytes,
)


def test_a_run_that_does_not_fit_is_refused_with_a_batch_size_that_does(
    monkeypatch: pytest.MonkeyPatch,
):
    config = preset("nano-tokenizer")
    config = replace(config, batches=replace(config.batches, batch_size=4, views=(2,)))
    smaller = replace(config, batches=replace(config.batches, batch_size=2))
    limit = training_memory_bytes(smaller, model_on_paper(smaller), 128, 128)
    monkeypatch.setattr(memory, "available_bytes", lambda device: limit)
    monkeypatch.setattr(memory, "resident_bytes", lambda: 0)
    check_memory(smaller, 128, 128)
    with pytest.raises(NotEnoughMemoryError) as caught:
        check_memory(config, 128, 128)
    assert str(caught.value).startswith("batches of size 4 with up to ")
    fitting = int(str(caught.value).split("--batches.batch-size ")[1].split()[0])
    assert 2 <= fitting < 4
    check_memory(replace(config, batches=replace(config.batches, batch_size=fitting)), 128, 128)
    limit = 1000
    with pytest.raises(NotEnoughMemoryError, match="not even a batch size of 1 would fit"):
        check_memory(config, 128, 128)


def test_a_model_without_a_backbone_counts_its_cells():
    config = replace(preset("nano-segmenter"), amp=False)
    model = model_on_paper(config)
    parameters = sum(p.numel() for p in model.parameters())
    per_sample = flop_per_sample(config, model, 2, 16, 16)
    own = sum(p.numel() for p in model.parameters(recurse=False))  # of no part: the queries
    assert per_sample == 6 * (parameters - own) * 2 * 8 * 8
    small, large = (training_memory_bytes(config, model, side, side) for side in (16, 32))
    assert large > small
