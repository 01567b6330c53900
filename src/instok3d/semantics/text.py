"""Text as vectors, without a network: a table with one vector for each word, or piece of one.

The table is distilled from a language model (runs/text_table.py): a text is the mean of its
pieces, frequent ones counting less, which is enough for names of things and their colours. Names
of household things that are more than one piece have a vector of their own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Float, Int8
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional

from instok3d.files import replacing
from instok3d.reading import naming_damage
from instok3d.semantics.wordpiece import UNKNOWN, pieces

FORMAT = "instok3d-text-1"


@dataclass(frozen=True)
class TextTable:
    """Vectors of the pieces of words. A text's vector has unit length."""

    vocabulary: tuple[str, ...]
    """The piece of each row; ## begins those within a word, a space parts the words of a name."""
    rows: Int8[Tensor, "piece channel"]
    scales: Float[Tensor, " piece"]
    """What each row is multiplied by; the weight of a piece in a text is in its length."""
    source: str = ""
    """What the table was distilled from, with its licence."""

    @cached_property
    def ids(self) -> dict[str, int]:
        """The row of each piece."""
        return {piece: number for number, piece in enumerate(self.vocabulary)}

    def embed(self, texts: Sequence[str]) -> Float[Tensor, "text channel"]:
        """A unit vector for each text; the cosine of two says how alike they are.

        Raises:
            ValueError: A text has no word that the table knows.
        """
        found = []
        for text in texts:
            known = [each for each in pieces(text, self.ids) if self.vocabulary[each] != UNKNOWN]
            if not known:
                raise ValueError(f"no word of {text!r} is known: describe it in English words")
            found.append((self.rows[known].float() * self.scales[known, None]).mean(dim=0))
        empty = torch.zeros(0, self.rows.shape[1])
        return functional.normalize(torch.stack(found), dim=1) if found else empty


def quantized(
    vectors: Float[Tensor, "piece channel"], vocabulary: Sequence[str], source: str
) -> TextTable:
    """A table of vectors, each rounded to 127 steps of its largest channel."""
    scales = vectors.abs().amax(dim=1).clamp_min(1e-9) / 127
    rows = (vectors / scales[:, None]).round().to(torch.int8)
    return TextTable(tuple(vocabulary), rows, scales, source)


def save_table(table: TextTable, path: Path, *, overwrite: bool = False) -> None:
    """Write a table as one safetensors file.

    Raises:
        FileExistsError: The file is there.
    """
    metadata = {
        "format": FORMAT,
        "vocabulary": "\n".join(table.vocabulary),
        "source": table.source,
    }
    with replacing(path, overwrite=overwrite) as part:
        save_file({"rows": table.rows, "scales": table.scales}, part, metadata)


def load_table(path: Path) -> TextTable:
    """Read a table that `save_table` wrote.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no such table, or damaged.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no text table {path}")
    with naming_damage(path, "make or download it again"), safe_open(path, "pt") as file:
        metadata = file.metadata() or {}
        if metadata.get("format") != FORMAT:
            raise ValueError(f"{path} is no text table of format {FORMAT!r}")
        rows, scales = file.get_tensor("rows"), file.get_tensor("scales")
    vocabulary = tuple(metadata.get("vocabulary", "").split("\n"))
    sound = rows.dtype == torch.int8 and rows.ndim == 2 and scales.dtype == torch.float32
    if not sound or not len(vocabulary) == len(rows) == len(scales):
        raise ValueError(f"{path} is damaged: words, rows and scales do not fit together")
    if UNKNOWN not in vocabulary or not scales.isfinite().all():
        raise ValueError(f"{path} is damaged: no piece {UNKNOWN}, or scales that are not finite")
    return TextTable(vocabulary, rows, scales, metadata.get("source", ""))
