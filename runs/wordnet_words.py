"""Words from WordNet's database: what a home may hold, and which words are common ones.

The database is the folder with data.noun of WordNet 3.x; Debian's package wordnet-base has it as
/usr/share/wordnet.
"""

import re
from pathlib import Path

ROOTS = (
    "furnishing", "furniture", "home appliance", "container", "lamp", "curtain", "bedclothes",
    "floor cover", "tableware", "plaything", "musical instrument", "electronic equipment",
    "garment", "footwear", "decoration", "fixture", "partition", "door", "window", "electric lamp",
    "timepiece", "kitchen utensil", "hand tool", "linen", "picture", "publication", "houseplant",
    "computer", "display", "heater", "cushion", "mirror", "luggage", "stairway", "ornament",
)  # fmt: skip
"""Names of WordNet; each stands for its first meaning of a thing, and all kinds of it."""
THINGS = {"06", "10", "20"}
"""Files of the lexicographers: artefacts, communication (books, pictures), plants."""
FORM = re.compile("[a-z]+( [a-z]+){0,2}")
ENDINGS = (("s", ""), ("ies", "y"), ("es", ""), ("ed", ""), ("ed", "e"), ("ing", ""), ("ing", "e"),
           ("er", ""), ("er", "e"), ("est", ""), ("est", "e"), ("ly", ""))  # fmt: skip
"""Of inflected words, and what stands in their place in the word itself."""


def household_names(database: Path) -> list[str]:
    """Names of one to three words of all kinds of the ROOTS, sorted."""
    names, kinds, files = _read_nouns(database / "data.noun")
    senses = _read_senses(database / "index.noun")
    waiting = [next(s for s in senses[root] if files[s] in THINGS) for root in ROOTS]
    meant: set[str] = set()
    while waiting:
        place = waiting.pop()
        if place not in meant:
            meant.add(place)
            waiting += kinds[place]
    return sorted({name for place in meant for name in names[place] if FORM.fullmatch(name)})


class CommonWords:
    """Which words are in the database, inflected or not, and not only as proper names."""

    def __init__(self, database: Path) -> None:
        self.words: set[str] = set()
        for kind in ("noun", "verb", "adj", "adv"):
            for line in _lines(database / f"data.{kind}"):
                names = _names(line.partition(" |")[0].split())
                self.words |= {name.partition("(")[0] for name in names if name == name.lower()}
            irregular = (database / f"{kind}.exc").read_text(encoding="latin-1")
            self.words |= {line.split()[0] for line in irregular.splitlines()}

    def __contains__(self, word: str) -> bool:
        stems = {word} | {
            word.removesuffix(end) + put for end, put in ENDINGS if word.endswith(end)
        }
        doubled = {stem[:-1] for stem in stems if len(stem) > 3 and stem[-1] == stem[-2]}
        return not self.words.isdisjoint(stems | doubled)


def _lines(path: Path) -> list[str]:
    lines = path.read_text(encoding="latin-1").splitlines()
    return [line for line in lines if not line.startswith(" ")]  # those are the licence


def _names(parts: list[str]) -> list[str]:
    count = int(parts[3], 16)
    return [name.replace("_", " ") for name in parts[4 : 4 + 2 * count : 2]]


def _read_nouns(path: Path) -> tuple[dict[str, list[str]], dict[str, list[str]], dict[str, str]]:
    """Names, kinds (places of hyponyms) and the lexicographers' file of each meaning."""
    names, kinds, files = {}, {}, {}
    for line in _lines(path):
        parts = line.partition(" |")[0].split()
        place = parts[0]
        names[place] = [name.lower() for name in _names(parts)]
        files[place] = parts[1]
        pointers = parts[5 + 2 * len(names[place]) :]
        kinds[place] = [
            pointers[k + 1] for k in range(0, len(pointers) - 3, 4) if pointers[k] == "~"
        ]
    return names, kinds, files


def _read_senses(path: Path) -> dict[str, list[str]]:
    """The meanings of each name, the most frequent first."""
    senses = {}
    for line in _lines(path):
        parts = line.split()
        senses[parts[0].replace("_", " ")] = parts[-int(parts[2]) :]
    return senses
