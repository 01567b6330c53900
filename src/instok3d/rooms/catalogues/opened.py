"""The catalogues of a run, and what a folder of rooms keeps of them: names, hashes, credits."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instok3d.files import replacing
from instok3d.reading import one_line, text, whole_number
from instok3d.rooms.catalogues.entries import counted, digest
from instok3d.rooms.catalogues.models import FurnitureCatalogue
from instok3d.rooms.catalogues.texture_files import TextureCatalogue

CREDITS = "CREDITS.txt"


@dataclass(frozen=True)
class Catalogues:
    """What rooms take from files beside what the generators make."""

    furniture: FurnitureCatalogue | None = None
    textures: TextureCatalogue | None = None

    @staticmethod
    def open(furniture: Path | None = None, textures: Path | None = None) -> "Catalogues":
        """Read and check the catalogues of two folders; None is no catalogue.

        Raises:
            FileNotFoundError: A folder has no catalogue, or a file of it is missing.
            ValueError: A catalogue or a file is damaged, or nothing in it is usable.
        """
        return Catalogues(
            None if furniture is None else FurnitureCatalogue.open(furniture),
            None if textures is None else TextureCatalogue.open(textures),
        )

    def _named(self) -> dict[str, FurnitureCatalogue | TextureCatalogue]:
        both = {"furniture": self.furniture, "textures": self.textures}
        return {kind: catalogue for kind, catalogue in both.items() if catalogue is not None}

    def record(self) -> dict[str, Any]:
        """For the index of a folder of rooms; empty without catalogues.

        The hash covers the files in use, their licences and their classes, not the folder's place.
        """
        return {
            kind: {
                "name": catalogue.folder.resolve().name,
                "sha256": digest(catalogue.folder, catalogue.entries),
                "items": len(catalogue.entries),
                "licenses": dict(sorted(Counter(e.license for e in catalogue.entries).items())),
                "credits": sorted(entry.credit for entry in catalogue.entries),
            }
            for kind, catalogue in self._named().items()
        }

    def summary(self) -> list[str]:
        """One line for each catalogue: how much of it is used, and why the rest is not."""
        return [
            f"{kind}: {len(catalogue.entries)} of "
            f"{len(catalogue.entries) + sum(catalogue.left_out.values())} used"
            + (f"; left out: {counted(catalogue.left_out)}" if catalogue.left_out else "")
            for kind, catalogue in self._named().items()
        ]


NO_CATALOGUES = Catalogues()


def check_record(record: Mapping[str, Any]) -> None:
    """Raise ValueError where an index's record of catalogues cannot be one."""
    for kind, catalogue in record.items():
        if kind not in ("furniture", "textures"):
            raise ValueError(f"{kind!r} is no kind of catalogue")
        for key in ("name", "sha256"):
            text(catalogue[key])
        whole_number(catalogue["items"], 1)
        for line in catalogue["credits"]:
            one_line(line)


def told_apart(record: Mapping[str, Any]) -> dict[str, str]:
    """By what two records are compared: short text for each catalogue."""
    return {kind: f"{c['name']} ({c['sha256'][:12]})" for kind, c in record.items()}


def credits_of(record: Mapping[str, Any]) -> list[str]:
    """Everyone whose work may be seen in rooms with these catalogues, one line for each."""
    return [line for catalogue in record.values() for line in catalogue["credits"]]


def write_credits(folder: Path, record: Mapping[str, Any]) -> None:
    """Write CREDITS.txt into a folder of rooms; nothing where nothing was used."""
    if not record:
        return
    lines = [
        "The pictures of these rooms show furniture models and textures of others, changed in size",
        "of their textures, in light and in tint. A model that is trained on them passes this on.",
    ]
    for kind, catalogue in record.items():
        lines += ["", f"{kind.capitalize()} from {catalogue['name']}:", *catalogue["credits"]]
    with replacing(folder / CREDITS) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="surrogateescape")
