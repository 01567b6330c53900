from dataclasses import replace

import pytest

from instok3d.errors import NotEnoughMemoryError
from instok3d.model import memory
from instok3d.training.config import preset
from instok3d.training.cost.estimate import check_memory, model_on_paper, training_memory_bytes


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
