"""`instok3d query`: objects of a scene by a text or a picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor

    from instok3d.scene.query import Answers, SceneQueries

IMAGE_SIDE = 256
"""Pictures are looked at in a square of so many pixels, the rest cropped away."""


def run(
    scene: tyro.conf.Positional[Path],
    text: tyro.conf.Positional[str | None] = None,
    /,
    image: Path | None = None,
    k: Annotated[int, tyro.conf.arg(aliases=["-k"])] = 5,
    json: bool = False,
    heatmap: Path | None = None,
    teacher: str | None = None,
    up: tuple[str, ...] | None = None,
    overwrite: bool = False,
) -> None:
    """Search a scene: "the red chair", "all lamps", "largest table", "lamp on the desk".

    Prints the objects that are likely enough to be meant, the likeliest first, or that none is
    there. docs/queries.md has what is understood.

    Args:
        scene: A scene folder with semantics.
        text: What is looked for, in quotation marks, or
        image: a picture of one thing.
        k: At most so many objects, unless the text asks for several.
        json: Print one JSON object.
        heatmap: A folder for one PNG a photo: how likely each pixel shows the thing's name or
            picture.
        teacher: Weights of another encoder that saw the scene: lseg:FILE, clip:FOLDER or
            siglip2:FOLDER.
        up: An axis such as z (-y: --up=-y), or x y z: up for this command.
        overwrite: Replace a folder that is already there.
    """
    from instok3d.cli.info import print_json
    from instok3d.cli.targets import check_target, load_scene
    from instok3d.scene.query import SceneQueries
    from instok3d.semantics.query.grammar import understand
    from instok3d.semantics.query.shipped import find_encoder

    if (text is None) == (image is None):
        raise ValueError('give a text such as "the red chair", or --image FILE, one of the two')
    if k < 1:
        raise ValueError(f"-k must be at least 1, got {k}")
    if text is not None:
        understand(text)  # fails before anything is read
    picture = None if image is None else read_picture(image)
    if heatmap is not None:
        check_target(heatmap, overwrite=overwrite, folder=True)
    loaded = load_scene(scene, up)
    queries = SceneQueries(loaded, find_encoder(loaded.semantics, teacher))
    answers = queries.picture(picture, k) if picture is not None else queries.text(text or "", k)
    maps = [] if heatmap is None else write_heat_maps(
        queries, queries.wanted_vector(text, picture), heatmap, overwrite=overwrite
    )  # fmt: skip
    if json:
        print_json(as_values(answers, text, image, maps))
    else:
        print(f"understood: {answers.understood}\n{table(answers)}")
        if maps:
            print(f"{len(maps)} heat maps written to {heatmap}")


def read_picture(file: Path) -> "Float[Tensor, '3 height width']":
    """A picture of one thing in [0, 1].

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no picture.
    """
    from instok3d.photos.image_decoding import decode_photo

    return decode_photo(file, height=IMAGE_SIDE, width=IMAGE_SIDE).image


def as_values(
    answers: "Answers", text: str | None, image: Path | None, maps: list[str]
) -> dict[str, Any]:
    """The answer in plain values."""
    closest = answers.ranked[:3] if not answers.present else ()
    return {
        "text": text,
        "image": None if image is None else str(image),
        "understood": answers.understood,
        "encoder": answers.encoder,
        "threshold": answers.threshold,
        "present": answers.present,
        "several": answers.several,
        "answers": [answer.to_json() for answer in answers],
        "closest": [answer.to_json() for answer in closest],
        "heatmaps": maps,
    }


def table(answers: "Answers") -> str:
    """The answer in lines."""
    if not answers.present:
        return answers.words()
    rows = []
    for place, answer in enumerate(answers, 1):
        item = answer.object
        size = " x ".join(f"{length:.2g}" for length in item.obb.size)
        at = ", ".join(f"{value:.2f}" for value in item.obb.center)
        score = "" if answer.score is None else f"  score {answer.score:.2f}"
        rows.append(
            f"{place:3} {item.key:24} {answer.probability:4.0%}{score}  size {size}  at ({at})"
        )
    return "\n".join(rows)


def write_heat_maps(
    queries: "SceneQueries",
    wanted: "Float[Tensor, ' channel']",
    folder: Path,
    *,
    overwrite: bool,
) -> list[str]:
    """NNN.png of each input view: grey, and redder where the thing is likelier; their paths."""
    import numpy as np
    from PIL import Image

    from instok3d.files import replacing_folder
    from instok3d.pictures import save_png

    maps, photos = queries.heat_maps(wanted), queries.scene.photos.cpu().numpy()
    names = []
    with replacing_folder(folder, overwrite=overwrite) as part:
        for view, (heat, photo) in enumerate(zip(maps.numpy(), photos, strict=True)):
            grey = photo.mean(axis=2, keepdims=True).repeat(3, axis=2)
            red = np.array([255.0, 32.0, 0.0])
            mixed = grey * (1 - 0.8 * heat[..., None]) + red * 0.8 * heat[..., None]
            names.append(f"{view:03d}.png")
            save_png(Image.fromarray(mixed.round().astype(np.uint8)), part / names[-1])
    return [str(folder / name) for name in names]
