"""Which scenes a folder holds, and what is made of each."""

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch

from instok3d.hub.references import is_hub
from instok3d.model.files import load_model
from instok3d.photos.file_names import IMAGE_SUFFIXES
from instok3d.photos.video import VIDEO_SUFFIXES

ENDING = ".itk"


@dataclass(frozen=True)
class Options:
    """What `instok3d batch` takes over for all scenes from `instok3d reconstruct`."""

    model: Path | None = None
    """A model file instead of the default model, or hub:USER/NAME@COMMIT."""
    geometry: str = "nano"
    """Where cameras and depth come from, as in `instok3d reconstruct`."""
    refine: int | None = None
    """Steps of refinement; None takes the default."""
    clean_up: bool = True
    """Make groups whole objects."""
    max_views: int = 16
    """Of more photos, this many are chosen to cover all."""
    pixels: int | None = None
    """Height and width at which the model sees the photos; None takes that of its training."""
    seed: int = 0
    """Same photos, model and seed give the same bytes, with as many threads."""
    device: str = "cpu"
    """Where the model runs, such as cuda."""

    def record(self) -> dict[str, object]:
        """As JSON."""
        model = None if self.model is None else self.model.as_posix()
        if self.model is not None and not is_hub(self.model):
            model = self.model.resolve().as_posix()
        return {**vars(self), "model": model}


@dataclass(frozen=True)
class SceneJob:
    """One scene that is to be made."""

    name: str
    photos: Path
    """A folder, or a video."""
    output: Path
    options: Options
    threads: int


@dataclass(frozen=True)
class MadeScene:
    """What came out."""

    objects: int
    gaussians: int


def find_scenes(folder: Path) -> dict[str, Path]:
    """Name and place of each scene: subfolders with photos, and videos; in order.

    Raises:
        FileNotFoundError: There is no such folder.
        ValueError: It holds none, or two of one name.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if not (path.is_dir() or path.suffix.lower() in VIDEO_SUFFIXES):
            continue
        name = path.name if path.is_dir() else path.stem
        if name in found:
            raise ValueError(
                f"{found[name]} and {path} would both become {name}{ENDING}: rename one of them"
            )
        found[name] = path
    if not found:
        photos = any(path.suffix.lower() in IMAGE_SUFFIXES for path in folder.iterdir())
        hint = ": its photos are those of one scene, which `reconstruct` makes" if photos else ""
        raise ValueError(f"{folder} has no subfolder with photos and no video{hint}")
    return found


def fingerprint(photos: Path) -> str:
    """What tells whether the files of a scene were changed: their names, sizes and times."""
    files = sorted(photos.rglob("*")) if photos.is_dir() else [photos]
    digest = hashlib.sha256()
    for path in files:
        about = path.stat()
        line = f"{path.relative_to(photos.parent)} {about.st_size} {about.st_mtime_ns}\n"
        digest.update(line.encode(errors="surrogateescape"))
    return digest.hexdigest()


def make_scene(job: SceneJob) -> MadeScene:
    """Reconstruct and save one scene. The model is loaded once by each process.

    Raises:
        FileNotFoundError, ValueError, MemoryError: As `instok3d.reconstruct`.
    """
    from instok3d.refinement.settings import DEFAULT_STEPS
    from instok3d.scene.previews import save_with_previews
    from instok3d.scene.reconstruct import reconstruct

    if torch.get_num_threads() != job.threads:
        torch.set_num_threads(job.threads)
    options = job.options
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the scene keeps them
        scene = reconstruct(
            job.photos,
            geometry=options.geometry,
            model=options.model,
            seed=options.seed,
            refine=DEFAULT_STEPS if options.refine is None else options.refine,
            clean_up=options.clean_up,
            max_views=options.max_views,
            pixels=options.pixels,
            device=options.device,
            read_model=held_model,
        )
        save_with_previews(scene, job.output, overwrite=True)
    return MadeScene(len(scene.objects), len(scene.gaussians.means))


held_model: Callable = lru_cache(maxsize=1)(load_model)
"""`load_model`, which keeps the last model of this process."""
