"""A library in a folder: one writer at a time, any number of readers beside it.

    library.json            the manifest; what it does not name is not in the library
    shards/N.safetensors    objects, written once; scenes are added as shards of their own, and
                            small shards are joined now and then into larger ones

A writer writes a shard whole, then the manifest. Killed anywhere it leaves the library as it was
before or after the scene in flight, and perhaps a file that no manifest names, which the next
writer removes.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from instok3d.files import sha256_of
from instok3d.library.entries import (
    Audit,
    Encoder,
    Entry,
    Match,
    SceneEntries,
    StoredScene,
    check_encoder,
)
from instok3d.library.manifest import (
    NAME,
    Manifest,
    ShardRecord,
    read_manifest,
    write_manifest,
)
from instok3d.library.search import nearest
from instok3d.library.shards import REMEDY, Addition, Shard, Source, source_of, write_shard
from instok3d.locking import alone_in, remove_leftovers

SHARDS = "shards"
JOINED = 8
"""So many shards of about one size become one; shards of two sizes differ by this factor."""
TRIES = 100
"""A reader that meets a shard gone reads the manifest again: a writer has joined shards."""


class FolderLibrary:
    """A library on disk as it was when it was opened, or last written through this object."""

    def __init__(self, folder: Path) -> None:
        """Open a library.

        Raises:
            FileNotFoundError: There is none.
            ValueError: It is damaged, or of a newer version.
        """
        self.folder = folder
        self._open(_opened(folder))

    @staticmethod
    def create(folder: Path) -> "FolderLibrary":
        """The library of a folder, which is made if there is nothing yet.

        Raises:
            FileExistsError: There is something else.
        """
        if not (folder / NAME).exists():
            if folder.is_dir():
                remove_leftovers(folder)  # of one that was killed at this very point
            if folder.exists() and not (folder.is_dir() and _is_free(folder)):
                raise FileExistsError(
                    f"{folder} is there and is no library: give a new name, or an empty folder"
                )
            folder.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):  # another writer was quicker
                write_manifest(folder, Manifest(), new=True)
        return FolderLibrary(folder)

    @property
    def encoder(self) -> Encoder | None:
        """Of its embeddings; None as long as nothing was added."""
        return self._manifest.encoder

    def scenes(self) -> list[StoredScene]:
        """All scenes, in the order of their places."""
        return [StoredScene(scene, each.rows) for scene, each in sorted(self._present.items())]

    def query(self, embedding: Float[np.ndarray, " channel"], count: int) -> list[Match]:
        """The objects nearest to an embedding by cosine, nearest first; every object is looked at.

        Args:
            embedding: Of the library's encoder, of any length but 0.
            count: How many; there may be fewer.

        Raises:
            ValueError: The embedding is none, or a shard is damaged.
        """
        if self.encoder is None:
            return []
        if embedding.shape != (self.encoder.channels,) or not np.isfinite(embedding).all():
            raise ValueError(f"the query must be {self.encoder.channels} finite numbers")
        if not embedding.any():
            raise ValueError("the query is 0, which is like nothing")
        unit = (embedding / np.linalg.norm(embedding)).astype(np.float32)
        best = []
        for shard in self._shards:
            found = nearest(shard.embeddings, unit, count, shard.left_out(self._manifest.removed))
            best += [
                (-float(score), shard.addition_of(int(row)), int(row), shard)
                for row, score in zip(found.rows, found.scores, strict=True)
            ]
        best.sort(key=lambda each: each[:3])
        return [
            Match(shard.scene_of[addition], shard.entry(row), -score)
            for score, addition, row, shard in best[:count]
        ]

    def entry(self, scene: str, number: int) -> Entry:
        """One object of a scene.

        Args:
            scene: As `scenes` names it.
            number: The object's id.

        Raises:
            KeyError: There is no such scene, or it has no such object here.
            ValueError: A shard is damaged.
        """
        if scene not in self._present:
            raise KeyError(f"the scene {scene!r} is not in the library")
        addition = self._present[scene].number
        shard = next((each for each in self._shards if addition in each.scene_of), None)
        row = None if shard is None else shard.row_of(addition, number)
        if shard is None or row is None:
            raise KeyError(f"the scene {scene!r} has no object {number} in the library")
        return shard.entry(row)

    def add(self, scene: str, entries: SceneEntries) -> None:
        """Add a scene, or put it in place of what was added from the same place.

        Raises:
            ValueError: Its encoder is not the library's, or another writer is at work.
        """
        with self._writing():
            check_encoder(self.encoder, entries.encoder, self.folder)
            old, before = self._present.get(scene), self._manifest
            addition = Addition(before.next_addition, scene, len(entries.objects))
            source = source_of(entries, addition.number)
            manifest = self._with_shard([addition], [source], entries.encoder.channels)
            removed = before.removed if old is None else before.removed | {old.number}
            self._publish(
                replace(
                    manifest,
                    encoder=entries.encoder,
                    next_addition=addition.number + 1,
                    removed=removed,
                ),
                self._present | {scene: addition},
            )
            self._join_alike()

    def remove(self, scenes: Sequence[str]) -> None:
        """Take scenes out; their room is given back when their shard is joined with others.

        Raises:
            KeyError: One is not in the library; none is taken out then.
            ValueError: Another writer is at work.
        """
        with self._writing():
            for scene in scenes:
                if scene not in self._present:
                    raise KeyError(f"{self.folder} has no scene {scene}: see `library list`")
            left = {name: each for name, each in self._present.items() if name not in scenes}
            numbers = {self._present[scene].number for scene in scenes}
            manifest = self._manifest
            self._publish(replace(manifest, removed=manifest.removed | numbers), left)

    def compact(self) -> None:
        """Write all that counts into one shard, and give the rest of the room back.

        Raises:
            ValueError: Another writer is at work, or a shard is damaged.
        """
        with self._writing():
            if len(self._manifest.shards) > 1 or self._manifest.removed:
                self._join(range(len(self._shards)))

    def verify(self) -> Audit:
        """Compare every shard with its checksum and look at all that is in it.

        Raises:
            ValueError: Something is damaged; says what.
        """
        for record, shard in zip(self._manifest.shards, self._shards, strict=True):
            found = sha256_of(shard.path)
            if found != record.sha256:
                raise ValueError(
                    f"{shard.path} is damaged: its SHA-256 is {found}, the manifest has "
                    f"{record.sha256}; {REMEDY}"
                )
            shard.check()
        scenes = self.scenes()
        return Audit(
            scenes=len(scenes),
            objects=sum(each.objects for each in scenes),
            bytes=sum(shard.path.stat().st_size for shard in self._shards),
        )

    def _open(self, opened: tuple[Manifest, tuple[Shard, ...]]) -> None:
        self._manifest, self._shards = opened
        self._present = {
            each.scene: each
            for shard in self._shards
            for each in shard.additions
            if each.number not in self._manifest.removed
        }

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Alone among writers, on the newest manifest, without what killed writers left."""
        refusal = f"another command is writing to {self.folder}: wait for its end and run again"
        with alone_in(self.folder / "lock", refusal):
            if read_manifest(self.folder) != self._manifest:
                self._open(_opened(self.folder))
            shards = self.folder / SHARDS
            shards.mkdir(exist_ok=True)
            for folder in (self.folder, shards):
                remove_leftovers(folder)
            named = {record.file for record in self._manifest.shards}
            for path in shards.glob("*.safetensors"):
                if path.name not in named:
                    path.unlink()
            yield

    def _with_shard(
        self, additions: Sequence[Addition], sources: Sequence[Source], channels: int
    ) -> Manifest:
        """The manifest with one more shard, which is on the disk then."""
        before = self._manifest
        name = f"{before.next_shard:08d}.safetensors"
        sha256 = write_shard(self.folder / SHARDS / name, additions, sources, channels)
        record = ShardRecord(name, sum(each.rows for each in additions), sha256)
        return replace(before, shards=(*before.shards, record), next_shard=before.next_shard + 1)

    def _publish(self, manifest: Manifest, present: dict[str, Addition]) -> None:
        """Make a manifest count, then remove the shards that it no longer names."""
        write_manifest(self.folder, manifest)
        gone = set(self._manifest.shards) - set(manifest.shards)
        known = dict(zip(self._manifest.shards, self._shards, strict=True))
        shards = (
            known.get(each) or Shard(self.folder / SHARDS / each.file) for each in manifest.shards
        )
        self._shards, self._manifest, self._present = tuple(shards), manifest, present
        for record in gone:
            with suppress(OSError):  # on Windows, while a reader has it open; the next writer tries
                (self.folder / SHARDS / record.file).unlink()

    def _join_alike(self) -> None:
        """Join shards of about one size while there are JOINED of them, the smallest first."""
        while True:
            sizes: dict[int, list[int]] = {}
            for index, record in enumerate(self._manifest.shards):
                sizes.setdefault(_size_class(record.rows), []).append(index)
            full = [size for size, indices in sizes.items() if len(indices) >= JOINED]
            if not full:
                return
            self._join(sizes[min(full)])

    def _join(self, indices: Sequence[int]) -> None:
        """Put what counts of some shards into one, behind the others."""
        before, encoder = self._manifest, self._manifest.encoder
        assert encoder is not None
        old = [self._shards[index] for index in indices]
        additions = [
            each for shard in old for each in shard.additions if each.number not in before.removed
        ]
        inside = {each.number for shard in old for each in shard.additions}

        manifest = before
        if additions:
            sources = [shard.source(before.removed) for shard in old]
            manifest = self._with_shard(additions, sources, encoder.channels)
        gone = {before.shards[index] for index in indices}
        self._publish(
            replace(
                manifest,
                shards=tuple(each for each in manifest.shards if each not in gone),
                removed=before.removed - inside,
            ),
            self._present,
        )


def _is_free(folder: Path) -> bool:
    """Whether nothing is in a folder, but for what another writer is making there right now."""
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".instok3d-")}
    return not names or NAME in names


def _opened(folder: Path) -> tuple[Manifest, tuple[Shard, ...]]:
    """The manifest, and the shards that it names, whatever a writer does meanwhile."""
    manifest = read_manifest(folder)
    for _ in range(TRIES):
        try:
            return manifest, tuple(_opened_shard(folder, each) for each in manifest.shards)
        except FileNotFoundError:
            before, manifest = manifest, read_manifest(folder)
            if manifest == before:
                break
    names = [f"{SHARDS}/{each.file}" for each in manifest.shards]
    missing = [name for name in names if not (folder / name).is_file()]
    raise ValueError(f"{folder} is damaged: {', '.join(missing[:3])} is gone; {REMEDY}")


def _opened_shard(folder: Path, record: ShardRecord) -> Shard:
    shard = Shard(folder / SHARDS / record.file)
    if shard.rows != record.rows:
        raise ValueError(
            f"{folder / NAME} is damaged: it says that {SHARDS}/{record.file} has {record.rows} "
            f"rows, and it has {shard.rows}; {REMEDY}"
        )
    return shard


def _size_class(rows: int) -> int:
    """How often a number of rows can be divided by JOINED: shards of one class are alike."""
    size = 0
    while rows >= JOINED:
        rows //= JOINED
        size += 1
    return size
