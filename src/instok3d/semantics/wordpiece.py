"""Words and pieces of words, as BERT's uncased vocabulary has them."""

import unicodedata
from collections.abc import Mapping

UNKNOWN = "[UNK]"
LONGEST_WORD = 100
"""Characters; what is longer is unknown."""
LONGEST_PHRASE = 3
"""Words that one entry of a vocabulary may have."""
_CJK = ((0x4E00, 0x9FFF), (0x3400, 0x4DBF), (0x20000, 0x2CEAF), (0xF900, 0xFAFF))


def basic_words(text: str) -> list[str]:
    """Lower-case words without accents; punctuation and ideographs are words of their own."""
    found, word = [], ""
    for char in unicodedata.normalize("NFD", text.lower()):
        kind = unicodedata.category(char)
        if kind == "Mn" or (kind.startswith("C") and not char.isspace()):
            continue
        alone = _is_punctuation(char, kind) or any(low <= ord(char) <= high for low, high in _CJK)
        if alone or char.isspace():
            found += [word] * bool(word) + [char] * alone
            word = ""
        else:
            word += char
    return found + [word] * bool(word)


def pieces(text: str, vocabulary: Mapping[str, int]) -> list[int]:
    """Token ids of a text: the longest phrases that are known, other words in pieces.

    Each word outside a phrase is cut into the longest pieces that are known.

    Args:
        text: Any; without a word there is no piece.
        vocabulary: Id of each piece, those within a word begin with ##; and of each phrase, words
            with a space between.
    """
    words, found, start = basic_words(text), [], 0
    while start < len(words):
        for end in range(min(len(words), start + LONGEST_PHRASE), start + 1, -1):
            phrase = " ".join(words[start:end])
            if phrase in vocabulary:
                found.append(vocabulary[phrase])
                break
        else:
            end = start + 1
            found += _pieces_of(words[start], vocabulary)
        start = end
    return found


def _pieces_of(word: str, vocabulary: Mapping[str, int]) -> list[int]:
    found, start = [], 0
    while start < len(word) <= LONGEST_WORD:
        for end in range(len(word), start, -1):
            piece = ("##" if start else "") + word[start:end]
            if piece in vocabulary:
                found.append(vocabulary[piece])
                start = end
                break
        else:
            return [vocabulary[UNKNOWN]]
    return found if start else [vocabulary[UNKNOWN]]


def _is_punctuation(char: str, kind: str) -> bool:
    """Unicode's punctuation, and all of ASCII that is neither letter nor digit."""
    return kind.startswith("P") or (char.isascii() and char.isprintable() and not char.isalnum()
                                    and not char.isspace())  # fmt: skip
