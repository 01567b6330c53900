"""`instok3d library`: the objects of many scenes, found by text or image."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    import numpy as np

    from instok3d.library.entries import Encoder, Match

COMMANDS = {
    "add": "the objects of scenes into a library",
    "query": "the objects of all scenes that a text or a picture means",
    "remove": "scenes out of a library",
    "list": "the scenes of a library",
    "compact": "give back the room of what was removed",
    "verify": "look at every byte of a library",
}
"""Subcommands of `instok3d library`."""

Library = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="LIB")]
Scenes = Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SCENE ...")]


def subcommand(name: str) -> Callable[..., int | None]:
    """One of COMMANDS."""
    return {
        "add": add,
        "query": query,
        "remove": remove,
        "list": list_scenes,
        "compact": compact,
        "verify": verify,
    }[name]


def add(library: Library, scenes: Scenes, /, encoder: str | None = None) -> None:
    """Add scenes to a library, which is made if it is not there.

    A scene that was added before is put in its old place. Each scene is kept as soon as its line
    is printed.

    Args:
        library: A folder, or milvus://HOST:PORT/NAME.
        scenes: Scene folders with semantics.
        encoder: Whose features are taken, where scenes have those of several.
    """
    from instok3d.cli.progress import plain_warnings
    from instok3d.library.adding import add_scene

    _need(scenes)
    with plain_warnings():
        for path in scenes:
            print(f"{path}: {add_scene(library, path, encoder)} objects")


def query(
    library: Library,
    text: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="TEXT")] = None,
    /,
    image: Path | None = None,
    k: Annotated[int, tyro.conf.arg(aliases=["-k"])] = 10,
    teacher: str | None = None,
    thumbnails: Path | None = None,
    json: bool = False,
) -> None:
    """Print the objects that are nearest to a text or to a picture, of all scenes of a library.

    Args:
        library: A folder, or milvus://HOST:PORT/NAME.
        text: What to look for.
        image: Or a picture of it.
        k: How many objects.
        teacher: What made the features, if it did not come with this package: lseg:FILE,
            clip:FOLDER, siglip2:FOLDER, dino:FOLDER or rooms:FILE.
        thumbnails: A new folder for a picture of each object.
        json: Print one JSON object.
    """
    from instok3d.cli.targets import check_target
    from instok3d.library.opening import open_library

    if (text is None) == (image is None):
        raise ValueError("give either a text to look for, or --image")
    if k < 1:
        raise ValueError(f"-k must be at least 1, got {k}")
    if thumbnails is not None:
        check_target(thumbnails, overwrite=False, folder=True)
    opened = open_library(library)
    if opened.encoder is None:
        raise ValueError(f"{library} is empty: add scenes first")
    found = opened.query(_embedding(opened.encoder, library, teacher, text, image), k)
    if thumbnails is not None:
        _write_thumbnails(thumbnails, found)
    if json:
        from instok3d.cli.info import print_json

        print_json({"library": library, "encoder": opened.encoder.name,
                    "matches": [each.to_json() for each in found]})  # fmt: skip
        return
    for rank, match in enumerate(found, 1):
        label = f" ({match.object.label})" if match.object.label else ""
        print(f"{rank:3} {match.score:6.3f}  {match.object.key}{label}  {match.scene}")


def remove(library: Library, scenes: Scenes, /) -> None:
    """Take scenes out of a library; the scenes themselves stay.

    Args:
        library: A folder, or milvus://HOST:PORT/NAME.
        scenes: As `instok3d library list` shows them, or as they were given to `add`.
    """
    from instok3d.library.opening import open_library
    from instok3d.library.scenes import scene_place

    _need(scenes)
    opened = open_library(library)
    known = {each.scene for each in opened.scenes()}
    given = [path.as_posix() for path in scenes]
    opened.remove([name if name in known else scene_place(Path(name)) for name in given])
    print(f"{library}: {len(opened.scenes())} scenes")


def list_scenes(library: Library, /, json: bool = False) -> None:
    """Print the scenes of a library.

    Args:
        library: A folder, or milvus://HOST:PORT/NAME.
        json: Print one JSON object.
    """
    from instok3d.library.opening import open_library

    opened = open_library(library)
    scenes = opened.scenes()
    if json:
        from instok3d.cli.info import print_json

        encoder = None if opened.encoder is None else vars(opened.encoder)
        print_json({"library": library, "encoder": encoder, "scenes": [vars(s) for s in scenes]})
        return
    for each in scenes:
        print(f"{each.objects:6} objects  {each.scene}")
    named = f", encoder {opened.encoder.name}" if opened.encoder else ""
    print(f"{sum(each.objects for each in scenes)} objects of {len(scenes)} scenes{named}")


def compact(library: Library, /) -> None:
    """Give back the room of what was removed, and make the library one file again.

    Args:
        library: A folder, or milvus://HOST:PORT/NAME.
    """
    from instok3d.library.opening import open_library

    open_library(library).compact()


def verify(library: Library, /) -> None:
    """Look at every byte of a library; ends with exit code 2 where something is damaged.

    Args:
        library: A folder, or milvus://HOST:PORT/NAME.
    """
    from instok3d.library.opening import open_library

    found = open_library(library).verify()
    print(
        f"{library}: {found.objects} objects of {found.scenes} scenes, {found.bytes} bytes: sound"
    )


def _need(scenes: Sequence[Path]) -> None:
    if not scenes:
        raise ValueError("no scene was named")


def _embedding(
    encoder: "Encoder", library: str, teacher: str | None, text: str | None, image: Path | None
) -> "np.ndarray":
    """What was asked for, in the space of a library's encoder."""
    from instok3d.library.questions import library_teacher, picture_embedding, text_embedding
    from instok3d.photos.image_decoding import decode_photo

    if text is not None and not text.strip():
        raise ValueError("the text is empty: describe what to look for")
    asked = library_teacher(encoder, library, teacher)
    if text is not None:
        return text_embedding(asked, text)
    assert image is not None
    photo = decode_photo(image, height=1, width=1, fit=lambda whole: whole)  # as it is
    return picture_embedding(asked, photo.image)


def _write_thumbnails(folder: Path, matches: "Sequence[Match]") -> None:
    from instok3d.files import replacing_folder

    with replacing_folder(folder, overwrite=False) as part:
        for rank, match in enumerate(matches, 1):
            (part / f"{rank:03d}.jpg").write_bytes(match.object.thumbnail)
    print(f"instok3d: {len(matches)} pictures in {folder}", file=sys.stderr)
