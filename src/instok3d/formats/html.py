"""A scene as one page for browsers."""

from pathlib import Path

from instok3d.formats.registry import ExportOptions
from instok3d.scene.scene import Scene
from instok3d.webpage import write_page


def write_html(path: Path, scene: Scene, options: ExportOptions) -> None:
    """Write a page that shows the scene, its objects to be selected, hidden and moved.

    Raises:
        FileExistsError: A file is there, and options.overwrite is off.
    """
    coefficients = (options.sh_degree + 1) ** 2
    write_page(scene, path, most_coefficients=coefficients, overwrite=options.overwrite)
