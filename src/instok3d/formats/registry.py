"""Which files of Gaussians can be read and written, by the ending of their names."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from instok3d.formats.sidecar import check_sidecar, with_sidecar, write_sidecar
from instok3d.formats.splats import Splats
from instok3d.scene.scene import Scene


@dataclass(frozen=True)
class ExportOptions:
    """How a scene is written."""

    sh_degree: int = 3
    """Degree of the colours where the format leaves a choice, 0 to 3."""
    with_ids: bool = False
    """Write the object of each Gaussian where the format can hold it besides its order."""
    overwrite: bool = False
    """Replace a file that is there."""


@dataclass(frozen=True)
class FileFormat:
    """One kind of file."""

    suffix: str
    """With its dots; of two that fit, the longer one holds."""
    about: str
    module: str
    """In instok3d.formats; imported when it is used."""
    reader: str = ""
    """A function of a path that returns `Splats`; empty where it is not read."""
    writer: str = ""
    """A function of a path, a `Scene` and `ExportOptions`; empty where it is not written."""
    keeps_order: bool = True
    """Whether the Gaussians are written in the scene's order, at least those of each object."""
    sidecar: bool = False
    """Whether it has no room to say of frame, units and objects, so that a JSON file beside it
    does."""

    def _function(self, name: str) -> Callable:
        return getattr(import_module(f"instok3d.formats.{self.module}"), name)

    def read(self, path: Path) -> Splats:
        """The Gaussians of a file of this kind.

        Raises:
            FileNotFoundError: No such file.
            ValueError: It is damaged or of another kind.
        """
        splats = self._function(self.reader)(path)
        return with_sidecar(path, splats) if self.sidecar else splats

    def write(self, path: Path, scene: Scene, options: ExportOptions) -> None:
        """Write a scene, atomically.

        Raises:
            FileExistsError: A file is there, and options.overwrite is off.
        """
        if self.sidecar:
            check_sidecar(path, overwrite=options.overwrite)
        self._function(self.writer)(path, scene, options)
        if self.sidecar:
            write_sidecar(path, scene, keeps_order=self.keeps_order)


FORMATS = (
    FileFormat(".ply", "3D Gaussian Splatting", "ply", "read_ply", "write_scene_ply"),
    FileFormat(
        ".compressed.ply",
        "PlayCanvas's",
        "compressed_ply",
        "read_compressed_ply",
        "write_compressed_ply",
    ),
    FileFormat(".glb", "glTF with KHR_gaussian_splatting", "gltf", "read_gltf", "write_gltf"),
    FileFormat(".usdz", "USD with ParticleField3DGaussianSplat", "usd", "", "write_usd"),
    FileFormat(
        ".splat", "antimatter15's viewer", "splat", "read_splat", "write_splat", sidecar=True
    ),
    FileFormat(".spz", "Niantic's, gzipped", "spz", "read_spz", "write_spz", sidecar=True),
    FileFormat(
        ".ksplat", "GaussianSplats3D", "ksplat", "read_ksplat", "write_ksplat", sidecar=True
    ),
    FileFormat(
        ".sog",
        "PlayCanvas's, pictures in a zip",
        "sog",
        "read_sog",
        "write_sog",
        keeps_order=False,
        sidecar=True,
    ),
    FileFormat(".html", "a page for browsers, which needs nothing else", "html", "", "write_html"),
)


def readable() -> tuple[str, ...]:
    """Endings of the files that can be read."""
    return tuple(each.suffix for each in FORMATS if each.reader)


def writable() -> tuple[str, ...]:
    """Endings of the files that can be written."""
    return tuple(each.suffix for each in FORMATS if each.writer)


def format_of(path: Path, *, to_write: bool) -> FileFormat:
    """The format of a file's name.

    Raises:
        ValueError: None has this ending, or it can only be read, or only be written.
    """
    fitting = [each for each in FORMATS if path.name.lower().endswith(each.suffix)]
    found = max(fitting, key=lambda each: len(each.suffix), default=None)
    if found is None or not (found.writer if to_write else found.reader):
        endings = writable() if to_write else readable()
        raise ValueError(
            f"cannot {'write' if to_write else 'read'} {path}: its name must end in "
            f"{', '.join(endings[:-1])}{' or ' if endings[1:] else ''}{endings[-1]}"
        )
    return found


def export_scene(scene: Scene, path: Path, options: ExportOptions | None = None) -> None:
    """Write the Gaussians of a scene as a file of the kind that its name ends in, atomically.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
        ModuleNotFoundError: The format needs a package that is not installed.
        ValueError: No format has this ending, or the format cannot hold the scene.
    """
    format_of(path, to_write=True).write(path, scene, options or ExportOptions())


def read_splats(path: Path) -> Splats:
    """The Gaussians of a file, or of a folder with one PLY for each group.

    Raises:
        FileNotFoundError: Nothing of this name is there.
        ModuleNotFoundError: The format needs a package that is not installed.
        ValueError: It is damaged, or no format that is read.
    """
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}")
    if path.is_dir():
        return import_module("instok3d.formats.group_folder").read_group_folder(path)
    return format_of(path, to_write=False).read(path)
