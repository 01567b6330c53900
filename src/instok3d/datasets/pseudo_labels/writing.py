"""Id maps of clips as 16-bit PNG files beside the footage; each folder appears whole."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

from instok3d.datasets.prepared import read_scene
from instok3d.datasets.prepared.masks import MASKS_FORMAT, MASKS_RECORD, read_masks_record
from instok3d.datasets.pseudo_labels.association import AssociationConfig, label_clip
from instok3d.datasets.pseudo_labels.interfaces import MaskProposer, MaskTracker
from instok3d.datasets.pseudo_labels.statistics import (
    ClipStatistics,
    StatisticsConfig,
    StatisticsOfClip,
)
from instok3d.files import replacing_folder, sha256_of, write_json
from instok3d.locking import alone_in, remove_leftovers
from instok3d.version import generator


@runtime_checkable
class LabelModel(MaskProposer, MaskTracker, Protocol):
    """A model that proposes and tracks, and says what its masks depend on."""

    def identity(self) -> dict[str, Any]:
        """Model, weights_sha256, library and settings: equal ones give equal masks."""
        ...


@dataclass(frozen=True)
class LabelConfig:
    """Everything about the labelling but the model."""

    association: AssociationConfig = field(default_factory=AssociationConfig)
    statistics: StatisticsConfig = field(default_factory=StatisticsConfig)
    max_side: int = 1024
    """Larger pictures are worked on at this size; the id maps are enlarged to the pictures'."""


@dataclass(frozen=True)
class Labelled:
    """What came of one clip."""

    folder: Path
    statistics: ClipStatistics
    outcome: Literal["made", "there already"]


@dataclass(frozen=True)
class Clip:
    """Consecutive pictures, and where their id maps go."""

    images: tuple[Path, ...]
    target: Path
    """The folder of the id maps."""
    names: tuple[str, ...]
    """The file names of the id maps in it."""


def scene_clip(scene: Path, model: str) -> Clip:
    """The pictures of a scene of a prepared folder; its id maps go to masks_MODEL.

    Raises:
        FileNotFoundError: It has no scene.json.
        ValueError: The scene.json is damaged.
    """
    names = tuple(f"{number:06d}.png" for number in range(len(read_scene(scene).sources)))
    images = tuple(scene / "images" / name for name in names)
    return Clip(images, scene / f"masks_{model}", names)


def footage_clip(images: Sequence[Path], target: Path) -> Clip:
    """Pictures of one's own, in their order; the id map of a.jpg is a.png.

    Raises:
        ValueError: Two pictures have one name but for its ending.
    """
    names = tuple(f"{path.stem}.png" for path in images)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"two pictures would have the id map {twice}; rename one of them")
    return Clip(tuple(images), target, names)


def label(
    clip: Clip,
    model: LabelModel,
    config: LabelConfig = LabelConfig(),
    *,
    overwrite: bool = False,
    progress: Callable[[int], Any] | None = None,
) -> Labelled:
    """Write the id maps of a clip and masks.json; what is there with equal settings is kept.

    Args:
        clip: Pictures and target.
        model: Proposes and tracks masks.
        config: Everything else; stands in masks.json.
        overwrite: Replace id maps that are there, whatever made them.
        progress: Called after each frame with the number of frames done since the last call, 1.

    Raises:
        FileExistsError: The target is there and no folder of id maps.
        ValueError: Its id maps were made with other settings, another run is making them, or a
            picture cannot be read.
    """
    clip.target.parent.mkdir(parents=True, exist_ok=True)
    refusal = f"another run is making {clip.target}; wait for its end"
    with alone_in(clip.target.with_name(f".{clip.target.name}.lock"), refusal):
        remove_leftovers(clip.target.parent)
        return _label(clip, model, config, overwrite, progress or (lambda _: None))


def _label(
    clip: Clip,
    model: LabelModel,
    config: LabelConfig,
    overwrite: bool,
    progress: Callable[[int], Any],
) -> Labelled:
    settings = _settings(model, config)
    if clip.target.exists():
        if not (clip.target / MASKS_RECORD).is_file():
            raise FileExistsError(
                f"{clip.target} is there but is no folder of id maps ({MASKS_RECORD} is missing); "
                "delete it or choose another"
            )
        if not overwrite:
            return Labelled(clip.target, _statistics_there(clip, settings), "there already")
    statistics = StatisticsOfClip(config.statistics)
    files: dict[str, list[int | str]] = {}
    sizes: list[tuple[int, int]] = []
    with replacing_folder(clip.target, overwrite=overwrite) as part:
        images = _images(clip, config.max_side, sizes)
        maps = label_clip(images, model, model, config.association)
        for number, (name, id_map) in enumerate(zip(clip.names, maps, strict=True)):
            statistics.add(id_map)
            picture = Image.fromarray(id_map).resize(sizes[number], Image.Resampling.NEAREST)
            picture.save(part / name, "PNG")
            files[name] = [(part / name).stat().st_size, sha256_of(part / name)]
            progress(1)
        result = statistics.result()
        _warn_of_nothing(clip, result)
        write_json(
            part / MASKS_RECORD,
            {"format": MASKS_FORMAT, **settings, "instok3d": generator(),
             "statistics": asdict(result), "files": files},
        )  # fmt: skip
    return Labelled(clip.target, result, "made")


def _settings(model: LabelModel, config: LabelConfig) -> dict[str, Any]:
    return {**model.identity(), "config": asdict(config)}


def _statistics_there(clip: Clip, settings: dict[str, Any]) -> ClipStatistics:
    """The figures of id maps that are there, if they are what would be made."""
    record = read_masks_record(clip.target)
    other = [key for key, value in settings.items() if record.settings.get(key) != value]
    if other or set(record.files) != set(clip.names):
        raise ValueError(
            f"{clip.target} was made with another {' and '.join(other) or 'set of frames'}; pass "
            "--overwrite to make the masks again"
        )
    try:
        return ClipStatistics(**record.statistics)
    except TypeError as error:
        raise ValueError(
            f"{clip.target / MASKS_RECORD} has other statistics ({error}); pass --overwrite to "
            "make the masks again"
        ) from error


def _images(
    clip: Clip, max_side: int, sizes: list[tuple[int, int]]
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """The upright pictures, none larger than max_side; their own sizes go to `sizes`."""
    for path in clip.images:
        try:
            with Image.open(path) as image:
                picture = ImageOps.exif_transpose(image).convert("RGB")
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            raise ValueError(f"{path} cannot be read as a picture: {error}") from error
        if sizes and picture.size != sizes[0]:
            raise ValueError(
                f"{path} has {picture.width} x {picture.height} pixels, the pictures before it "
                f"{sizes[0][0]} x {sizes[0][1]}; all pictures of a clip must have one size"
            )
        sizes.append(picture.size)
        scale = max_side / max(picture.size)
        if scale < 1:
            width, height = (max(1, round(side * scale)) for side in picture.size)
            picture = picture.resize((width, height), Image.Resampling.BOX)
        yield np.array(picture)


def _warn_of_nothing(clip: Clip, result: ClipStatistics) -> None:
    if not result.tracks:
        warnings.warn(f"no mask was found in {len(clip.images)} pictures of {clip.target.parent}; "
                      "their id maps are empty", stacklevel=3)  # fmt: skip
