"""The demo's scene: what the photos that come with the package give."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path

from instok3d.scene.previews import save_with_previews
from instok3d.scene.reconstruct import load, reconstruct
from instok3d.scene.scene import Scene


@contextmanager
def demo_photos() -> Iterator[Path]:
    """The folder of the photos of a rendered room that come with the package.

    Raises:
        FileNotFoundError: This installation lacks them.
    """
    folder = files("instok3d") / "assets" / "demo"
    if not folder.is_dir():
        raise FileNotFoundError("the demo's photos are missing from this installation: reinstall")
    with as_file(folder) as photos:
        yield photos


def demo(path: str | Path = "demo.itk", *, progress: Callable[[str], None] | None = None) -> Scene:
    """The demo's scene, from its folder; made there first, as `instok3d demo` does, if it is not.

    Args:
        path: The scene folder.
        progress: Called once if the scene has to be made, then with the name of each stage.

    Raises:
        FileNotFoundError: The demo's photos are missing; MissingWeightsError for the model.
        ValueError: Something else is at the path.
    """
    path = Path(path)
    if not path.exists():
        if progress is not None:
            progress(f"{path} is not there: making it from the demo's photos, in half a minute")
        with demo_photos() as photos:
            save_with_previews(reconstruct(photos, progress=progress), path, progress=progress)
    return load(path)
