import random
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from instok3d.semantics.text import TextTable, load_table, quantized, save_table

PIECES = ("[UNK]", "red", "chair", "sofa", "arm", "##chair")


@pytest.fixture
def table() -> TextTable:
    vectors = torch.tensor([[1.0, 1, 1], [2, 0, 0], [0, 1, 0], [0, 3, 4], [0, 0, 1], [0, 2, 0]])
    return quantized(vectors, PIECES, "made up")


def test_a_text_is_the_mean_of_its_pieces_by_their_weight(table: TextTable):
    found = table.embed(["red", "Red chair", "armchair", "sofa!"])
    root5 = 5**0.5
    expected = [[1, 0, 0], [2 / root5, 1 / root5, 0], [0, 2 / root5, 1 / root5], [0, 0.6, 0.8]]
    torch.testing.assert_close(found, torch.tensor(expected), atol=0.01, rtol=0)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(4))


def test_unknown_words_count_for_nothing_and_alone_are_refused(table: TextTable):
    assert torch.equal(table.embed(["a red zebra"]), table.embed(["red"]))
    for text in ("zebra", "", "!?"):
        with pytest.raises(ValueError, match=r"no word of .* is known"):
            table.embed([text])
    assert table.embed([]).shape == (0, 3)


def test_a_file_keeps_the_table(table: TextTable, tmp_path: Path):
    path = tmp_path / "table.safetensors"
    save_table(table, path)
    read = load_table(path)
    assert (read.vocabulary, read.source) == (PIECES, "made up")
    assert torch.equal(read.rows, table.rows)
    assert torch.equal(read.embed(["red sofa"]), table.embed(["red sofa"]))
    with pytest.raises(FileExistsError):
        save_table(table, path)


def test_damaged_and_other_files_are_named(table: TextTable, tmp_path: Path):
    path = tmp_path / "table.safetensors"
    with pytest.raises(FileNotFoundError, match="no text table"):
        load_table(path)
    save_file({"rows": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match="is no text table of format"):
        load_table(path)
    save_table(table, path, overwrite=True)
    whole, rng, said = path.read_bytes(), random.Random(0), []
    for _ in range(60):
        damaged = bytearray(whole)
        damaged[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged[: rng.choice([len(whole), rng.randrange(len(whole))])])
        try:
            load_table(path).embed(["red chair"])
        except ValueError as error:
            said.append(str(error))
    assert len(said) > 30
    assert all(words.startswith((str(path), "no word of")) for words in said)
