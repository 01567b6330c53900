"""Reading scenes of a prepared folder, single frames at a time."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from instok3d.data.scenes import SceneFrames
from instok3d.data.words import ObjectWords
from instok3d.datasets.prepared.format import SceneRecord, Split, read_scene
from instok3d.datasets.prepared.index import read_index
from instok3d.datasets.prepared.masks import MADE_BY, read_masks_record
from instok3d.datasets.scannet.labels import TABLE, read_label_table
from instok3d.reading import naming_damage, open_png

_SIXTEEN_BITS = ("I;16", "I")
"""Modes of grey PNG of 16 bits, in newer and older versions of Pillow."""


class PreparedScenes:
    """The scenes of a prepared folder, by name; a `SceneSource`.

    Args:
        folder: Written by `instok3d data prepare`.
        splits: Those that are kept.
        masks: Take the ids that this model made (`instok3d data masks`) instead of the true ones.

    Where ScanNet's label table lies in the folder, instances have words: each the class that most
    of its labelled pixels have in the frames that are read.

    Raises:
        FileNotFoundError: The folder has no index, or scenes have no such masks.
        ValueError: The index is damaged, has no scene of these splits, or has scenes of them
            without cameras; the masks are not one for each frame, or not all made alike.
    """

    def __init__(
        self, folder: Path | str, *, splits: Sequence[Split] = ("train",), masks: str | None = None
    ) -> None:
        self.folder = Path(folder)
        self._id_layer = "instances" if masks is None else f"masks_{masks}"
        index = read_index(self.folder)
        kept = [(name, index[name]) for name in sorted(index) if index[name]["split"] in splits]
        if not kept:
            raise ValueError(
                f"{self.folder} has {len(index)} scenes, none of them of the splits "
                f"{', '.join(splits)}"
            )
        unposed = [name for name, entry in kept if not entry.get("cameras", True)]
        if unposed:
            raise ValueError(
                f"{len(unposed)} scenes in {self.folder} have no cameras, such as {unposed[0]}; "
                "they serve for masks alone: delete them, or prepare them again with cameras"
            )
        table = self.folder / TABLE
        self._classes = read_label_table(table) if table.is_file() else None
        self._names = tuple(name for name, _ in kept)
        self._counts = tuple(entry["num_frames"] for _, entry in kept)
        if masks is not None:
            self._check_masks(masks)

    def __len__(self) -> int:
        return len(self._names)

    def name_of(self, number: int) -> str:
        """The folder name of scene `number`."""
        return self._names[number]

    def num_frames(self, number: int) -> int:
        """How many frames scene `number` has, by the index."""
        return self._counts[number]

    def record(self, number: int) -> SceneRecord:
        """What scene.json says of scene `number`."""
        record = _cached_scene(self.folder / self._names[number])
        if len(record.sources) != self._counts[number]:
            raise ValueError(
                f"{self.folder / self._names[number]} has {len(record.sources)} frames, the index "
                f"of the folder says {self._counts[number]}; run `instok3d data verify --index "
                f"{self.folder}`"
            )
        return record

    def frames(self, number: int, chosen: Sequence[int]) -> SceneFrames:
        """These frames of scene `number`; only their files are read.

        Ids are all -1 where the scene has none, depths 0.

        Raises:
            IndexError: The scene has no such frame.
            ValueError: A file is missing or damaged.
        """
        record, folder = self.record(number), self.folder / self._names[number]
        missing = [k for k in chosen if not 0 <= k < len(record.sources)]
        if missing:
            raise IndexError(f"{folder} has {len(record.sources)} frames, asked for {missing}")
        if record.world_from_cam is None or record.intrinsics is None:
            raise ValueError(f"{folder} has no cameras")
        shape = (len(chosen), record.height, record.width)
        images = [_read_png(folder, "images", k, (*shape[1:], 3)) for k in chosen]
        ids = self._layer(record, folder, self._id_layer, chosen)
        depths = self._layer(record, folder, "depths", chosen)
        labels = self._layer(record, folder, "labels", chosen) if self._classes else None
        return SceneFrames(
            name=self._names[number],
            images=torch.from_numpy(np.stack(images))
            if images
            else torch.empty((*shape, 3), dtype=torch.uint8),
            instances=torch.full(shape, -1) if ids is None else ids,
            depths_m=torch.zeros(shape) if depths is None else depths.float() / 1000,
            world_from_cam=torch.from_numpy(record.world_from_cam[list(chosen)]),
            intrinsics=torch.from_numpy(record.intrinsics[list(chosen)]),
            words=self._words(ids, labels),
        )

    def labels(
        self, number: int, chosen: Sequence[int]
    ) -> Int[Tensor, "frame height width"] | None:
        """Raw class ids of these frames, 0 = unlabelled; None where the scene has none."""
        folder = self.folder / self._names[number]
        return self._layer(self.record(number), folder, "labels", chosen)

    def _words(
        self,
        ids: Int[Tensor, "frame height width"] | None,
        labels: Int[Tensor, "frame height width"] | None,
    ) -> dict[int, ObjectWords]:
        classes = self._classes
        if classes is None or ids is None or labels is None:
            return {}
        inside = (ids > 0) & (labels > 0)
        pairs, counts = torch.stack([ids[inside], labels[inside]]).unique(dim=1, return_counts=True)
        words: dict[int, ObjectWords] = {}
        for place in counts.argsort(stable=True).tolist():  # the most frequent one stays
            raw_id = int(pairs[1, place])
            if name := classes.names.get(raw_id, ""):
                nyu40 = classes.nyu40_names.get(raw_id, "").lower()
                words[int(pairs[0, place])] = ObjectWords(name.lower(), nyu40=nyu40)
        return words

    def _layer(
        self, record: SceneRecord, folder: Path, layer: str, chosen: Sequence[int]
    ) -> Int[Tensor, "frame height width"] | None:
        if not layer.startswith("masks_") and f"{layer}/000000.png" not in record.files:
            return None
        size = (record.height, record.width)
        pixels = [_read_png(folder, layer, k, size).astype(np.int64) for k in chosen]
        return torch.from_numpy(np.stack(pixels) if pixels else np.empty((0, *size), np.int64))

    def _check_masks(self, model: str) -> None:
        """That every scene has them, one for each frame, all made in the same way."""
        again = f"`instok3d data masks {self.folder} --model {model}`"
        folders = [self.folder / name / self._id_layer for name in self._names]
        lacking = [folder.parent.name for folder in folders if not folder.is_dir()]
        if lacking:
            raise FileNotFoundError(
                f"{len(lacking)} of {len(self)} scenes of {self.folder} have no masks of {model} "
                f"(such as {lacking[0]}); make them with {again}"
            )
        first: dict[str, Any] = {}
        for folder, count in zip(folders, self._counts, strict=True):
            record = read_masks_record(folder)
            wanted = {f"{number:06d}.png" for number in range(count)}
            if record.files.keys() != wanted:
                raise ValueError(
                    f"{folder} has {len(record.files)} id maps for {count} frames; make them again "
                    f"with {again} --overwrite"
                )
            made_by = {key: record.settings.get(key) for key in MADE_BY}
            first = first or made_by
            other = [key for key in MADE_BY if made_by[key] != first[key]]
            if other:
                raise ValueError(
                    f"{folder} was made with another {' and '.join(other)} than the masks of "
                    f"{folders[0].parent.name}; make all alike with {again} --overwrite"
                )


@lru_cache(maxsize=64)
def _cached_scene(folder: Path) -> SceneRecord:
    return read_scene(folder)


def _read_png(folder: Path, layer: str, number: int, shape: tuple[int, ...]) -> np.ndarray:
    path = folder / layer / f"{number:06d}.png"
    remedy = f"`instok3d data verify {folder.parent}` finds all that is"
    if not path.is_file():
        raise ValueError(f"{path} is missing; {remedy}")
    with naming_damage(path, remedy), open_png(path) as image:
        if image.size != (shape[1], shape[0]):  # seen before anything large is decoded
            raise ValueError(f"{path} has the size {image.size}, its scene says {shape}")
        modes = ("RGB",) if len(shape) == 3 else _SIXTEEN_BITS
        if image.mode not in modes:
            raise ValueError(
                f"{path} has pixels of the mode {image.mode}, wanted {modes[0]}; {remedy}"
            )
        pixels = np.asarray(image)
    if pixels.shape != shape:
        raise ValueError(f"{path} has the shape {pixels.shape}, its scene says {shape}")
    return pixels
