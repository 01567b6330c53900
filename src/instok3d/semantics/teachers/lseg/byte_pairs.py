"""Text as token ids, the way CLIP does it: byte pairs, merged in the order of a published list."""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.reading import naming_damage
from instok3d.semantics.teachers.texts import too_long

END = "</w>"
"""Ends the last piece of a word."""
_WORDS = re.compile(r"'s|'t|'re|'ve|'m|'ll|'d|[^\W\d_]+|\d|(?:[^\s\w]|_)+")
REMEDY = "fetch merges.txt of openai/clip-vit-base-patch32 again"


@dataclass(frozen=True)
class BytePairs:
    """CLIP's tokenizer."""

    merges: tuple[tuple[str, str], ...]
    """Pairs of pieces that become one; earlier ones first."""

    @cached_property
    def ids(self) -> dict[str, int]:
        """The id of each piece; those that begin and end a text come last."""
        letters = list(_letters().values())
        joined = [first + second for first, second in self.merges]
        pieces = [*letters, *(each + END for each in letters), *joined]
        return {piece: number for number, piece in enumerate(pieces)}

    @cached_property
    def ranks(self) -> dict[tuple[str, str], int]:
        """The place of each pair in the order of merging."""
        return {pair: rank for rank, pair in enumerate(self.merges)}

    @property
    def size(self) -> int:
        """Number of tokens, with the two that begin and end a text."""
        return 2 * 256 + len(self.merges) + 2

    def encode(self, texts: Sequence[str], longest: int) -> Int[Tensor, "text token"]:
        """Token ids, each text between its begin and its end, padded with 0.

        Args:
            texts: One at least.
            longest: Most tokens of a text.

        Raises:
            ValueError: A text has more tokens.
        """
        rows = []
        for text in texts:
            found = self._pieces(text)
            if len(found) > longest - 2:
                raise too_long(text, len(found), longest - 2)
            rows.append([self.size - 2, *found, self.size - 1])
        ids = torch.zeros(len(rows), max(map(len, rows)), dtype=torch.int64)
        for row, found in zip(ids, rows, strict=True):
            row[: len(found)] = torch.tensor(found)
        return ids

    def _pieces(self, text: str) -> list[int]:
        letters = _letters()
        found = []
        for word in _WORDS.findall(unicodedata.normalize("NFC", text).lower()):
            spelt = [letters[byte] for byte in word.encode(errors="replace")]
            found += [self.ids[piece] for piece in self._merged([*spelt[:-1], spelt[-1] + END])]
        return found

    def _merged(self, pieces: list[str]) -> list[str]:
        """The pieces of a word after all merges, the earliest pair of the list first."""
        while True:
            pairs = set(pairwise(pieces))
            pair = min(pairs, key=lambda each: self.ranks.get(each, len(self.ranks)), default=None)
            if pair is None or pair not in self.ranks:
                return pieces
            merged, place = [], 0
            while place < len(pieces):
                together = (*pieces[place : place + 2],) == pair
                merged.append("".join(pair) if together else pieces[place])
                place += 1 + together
            pieces = merged


def load_byte_pairs(path: Path) -> BytePairs:
    """The tokenizer of a list of merges: a line of its version, then two pieces to a line.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no {path}, the list by which CLIP cuts words into tokens: fetch merges.txt "
            "of the repository openai/clip-vit-base-patch32 on the Hugging Face hub and put it "
            "beside the weights"
        )
    with naming_damage(path, REMEDY):
        lines = path.read_text(encoding="utf-8").strip().split("\n")
        if not lines[0].startswith("#version"):
            raise ValueError("its first line is not that of a list of merges")
        pairs = [tuple(line.split()) for line in lines[1:]]
        wrong = next((number for number, each in enumerate(pairs, 2) if len(each) != 2), None)
        if wrong is not None:
            raise ValueError(f"line {wrong} is no pair")
    return BytePairs(tuple((first, second) for first, second in pairs))


def _letters() -> dict[int, str]:
    """A printable character for each byte, in the order of the vocabulary."""
    printable = [*range(33, 127), *range(161, 173), *range(174, 256)]
    others = [byte for byte in range(256) if byte not in printable]
    shown = {byte: chr(byte) for byte in printable}
    return shown | {byte: chr(256 + number) for number, byte in enumerate(others)}
