"""`instok3d render`: pictures or a film of a scene."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Int, UInt8

    from instok3d.scene.picture_size import SizedCameras
    from instok3d.scene.scene import Scene

PICTURES, FILMS = (".png",), (".mp4",)


def run(
    scene: tyro.conf.Positional[Path],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    path: str = "inputs",
    frames: int = 60,
    fps: int = 20,
    height: int | None = None,
    width: int | None = None,
    only: str | None = None,
    ids: bool = False,
    holes: bool = False,
    up: tuple[str, ...] | None = None,
    overwrite: bool = False,
) -> None:
    """Render a scene along a path of cameras.

    Args:
        scene: A scene folder.
        output: A folder for one PNG a camera, a .png with all of them side by side, or an .mp4
            (needs the extra instok3d[video]).
        path: "inputs", "through" (a flight from input to input), "orbit", or a cameras.json in the
            format of a scene folder.
        frames: Pictures of an orbit or a flight, at least 1.
        fps: Pictures a second of a film, at least 1.
        height: Of the pictures, pixels. One side alone keeps the shape; both together show more on
            two sides where the shape is another one, and never stretch.
        width: Likewise.
        only: Id, key or label of one object to draw alone, on white; in a scene with semantics also
            words such as "the red chair".
        ids: Also write which object each pixel shows: NNN_ids.png with the ids in a folder, the
            objects' display colours below the pictures of a .png and instead of those of an .mp4.
        holes: Hatch in magenta where the picture showed what was removed and shows nothing now.
        up: An axis such as z (-y: --up=-y), or x y z: up for this command. `instok3d edit SCENE up`
            sets it for good.
        overwrite: Replace files that are already there.
    """
    from instok3d.cli.progress import plain_warnings
    from instok3d.cli.targets import check_file, load_scene, objects_by_words
    from instok3d.scene.paths import camera_path

    if output.suffix:
        check_file(output, overwrite=overwrite, endings=PICTURES + FILMS)
    elif output.exists() and not (output.is_dir() and (overwrite or not any(output.iterdir()))):
        raise FileExistsError(f"{output} is already there; pass --overwrite to write into it")
    if fps < 1:
        raise ValueError(f"fps must be at least 1, got {fps}")
    if holes and only is not None:
        raise ValueError("--holes marks what is missing from the whole picture: leave out --only")
    loaded = load_scene(scene, up)
    with plain_warnings():
        way = fit_to_file(camera_path(loaded, path, frames, height, width), output, ids=ids)
    drawn = None if only is None else objects_by_words(loaded, only)  # fails before a file is
    shots = take_shots(loaded, way, drawn, ids=ids, holes=holes)
    if output.suffix in FILMS:
        count = write_film(shots, output, fps, overwrite=overwrite)
    elif output.suffix in PICTURES:
        count = write_strip(shots, output, overwrite=overwrite)
    else:
        count = write_pictures(shots, output, overwrite=overwrite)
    print(f"{count} pictures written to {output}")


def fit_to_file(path: "SizedCameras", output: Path, *, ids: bool) -> "SizedCameras":
    """The path as a kind of file can hold it.

    Raises:
        ValueError: All pictures side by side are too large for one.
    """
    from instok3d.scene.picture_size import MAX_PICTURE_PIXELS, resize_cameras

    if output.suffix in FILMS:  # H.264 wants even sides: a row or a column more
        return resize_cameras(path, path.height + path.height % 2, path.width + path.width % 2)
    count = len(path.cameras.intrinsics)
    pixels = count * path.width * path.height * (2 if ids else 1)
    if output.suffix in PICTURES and pixels > MAX_PICTURE_PIXELS:
        raise ValueError(
            f"{output} would have {pixels:,} pixels, as {count} pictures of {path.width} x "
            f"{path.height} side by side; a picture may have {MAX_PICTURE_PIXELS:,}: write to a "
            "folder or a film, or give fewer frames or a smaller size"
        )
    return path


@dataclass(frozen=True)
class Shot:
    """One picture."""

    picture: "UInt8[np.ndarray, 'height width 3']"
    ids: "Int[np.ndarray, 'height width'] | None"
    colored_ids: "UInt8[np.ndarray, 'height width 3'] | None"
    """The ids in the objects' display colours."""


def take_shots(
    scene: "Scene",
    path: "SizedCameras",
    only: list[int] | None,
    *,
    ids: bool,
    holes: bool = False,
) -> Iterator[Shot]:
    """The pictures one after the other: together they could fill the memory."""
    from instok3d.pictures import color_picture, hatched, id_picture

    background = (0.0, 0.0, 0.0) if only is None else (1.0, 1.0, 1.0)
    for view in range(len(path.cameras.intrinsics)):
        camera = path.cameras.view(view)
        seen = scene.render(
            camera, path.height, path.width,
            only=only, ids=ids, background=background,
        )  # fmt: skip
        picture = color_picture(seen.colors[0])
        if holes:
            mask = scene.holes(camera, path.height, path.width)[0]
            picture = hatched(picture, mask.numpy())
        if seen.ids is None:
            yield Shot(picture, None, None)
        else:
            yield Shot(picture, seen.ids[0].numpy(), id_picture(seen.ids[0]))


def write_pictures(shots: Iterator[Shot], folder: Path, *, overwrite: bool) -> int:
    """NNN.png for each shot, and NNN_ids.png (16 bits, 0: no object) where there are ids."""
    import numpy as np
    from PIL import Image

    from instok3d.files import replacing

    folder.mkdir(parents=True, exist_ok=True)
    count = 0
    for count, shot in enumerate(shots, 1):
        with replacing(folder / f"{count - 1:03d}.png", overwrite=overwrite) as part:
            Image.fromarray(shot.picture).save(part)
        if shot.ids is not None:
            with replacing(folder / f"{count - 1:03d}_ids.png", overwrite=overwrite) as part:
                Image.fromarray(shot.ids.astype(np.uint16)).save(part)
    return count


def write_strip(shots: Iterator[Shot], file: Path, *, overwrite: bool) -> int:
    """All shots side by side in one PNG, the coloured ids below where there are some."""
    import numpy as np
    from PIL import Image

    from instok3d.files import replacing

    columns = [
        shot.picture if shot.colored_ids is None else np.vstack([shot.picture, shot.colored_ids])
        for shot in shots
    ]
    with replacing(file, overwrite=overwrite) as part:
        Image.fromarray(np.hstack(columns)).save(part)
    return len(columns)


def write_film(shots: Iterator[Shot], file: Path, fps: int, *, overwrite: bool) -> int:
    """An H.264 film of the shots, or of the coloured ids where there are some."""
    try:
        from imageio.v2 import get_writer
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "films need imageio: pip install 'instok3d[video]', or write to a folder instead"
        ) from error
    from instok3d.files import replacing

    count = 0
    with (
        replacing(file, overwrite=overwrite) as part,
        get_writer(part, fps=fps, macro_block_size=2) as writer,
    ):
        for shot in shots:
            writer.append_data(  # pyright: ignore[reportAttributeAccessIssue]
                shot.picture if shot.colored_ids is None else shot.colored_ids
            )
            count += 1
    return count
