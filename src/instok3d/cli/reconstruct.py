"""`instok3d reconstruct`: photos in, a scene folder out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro


def run(
    photos: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="INPUT ...", help_behavior_hint="(required)"),
    ],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    cameras: Path | None = None,
    geometry: Literal[
        "nano", "da3-small", "da3-base", "vggt-1b", "colmap", "given", "auto"
    ] = "nano",
    allow_outside: bool = False,
    up: tuple[str, ...] | None = None,
    model: Path | None = None,
    refine: int | None = None,
    clean_up: bool = True,
    semantics: str = "auto",
    teacher: str | None = None,
    keep_interrupted: bool = False,
    max_views: int = 16,
    pixels: int | None = None,
    seed: int = 0,
    device: str = "cpu",
    overwrite: bool = False,
    json: bool = False,
    timings: bool = False,
) -> None:
    """Make a scene of objects from photos of one room.

    Args:
        photos: A folder, files, a quoted pattern or a video; or a folder with photos in subfolders
            and their cameras beside them, in a file that --cameras takes.
        output: The scene folder to write, such as room.itk.
        cameras: Known cameras, and depth where it is there: a COLMAP folder, transforms.json or
            scene.json.
        geometry: Where cameras and depth come from: the model's own backbone (nano), another
            network (`instok3d models pull da3-small` fetches its weights), COLMAP
            (colmap, which needs `pip install 'instok3d[sfm]'`), --cameras alone (given), or the
            best network that is on this machine (auto).
        allow_outside: Open photos and depth that the camera file names outside of its folder.
        up: Which way is up in the scene's world, if its estimate is wrong: an axis such as z (-y:
            --up=-y), or x y z.
        model: A model file instead of the default model, or hub:USER/NAME@REVISION, a model that
            `instok3d models push` pushed to the Hugging Face hub.
        refine: Steps in which the Gaussians are optimised on the photos; 0 leaves them as the
            model's single pass gives them. None takes the default.
        clean_up: Join groups that hold one thing and give loose pieces to what surrounds them;
            --no-clean-up leaves the model's groups as they are.
        semantics: What names the objects and lets them be searched: auto, the encoder that comes
            with the default model or with one of the hub; none; or a file that
            `instok3d train export` wrote for --model.
        teacher: The 2D encoder of that file, such as lseg:FILE, where the file does not hold it.
        keep_interrupted: Ctrl-C during the refinement ends it there and keeps what is reached; a
            second one ends the command.
        max_views: Of more photos, this many are chosen to cover all.
        pixels: Height at which the model sees the photos, a multiple of 8, instead of the 128 of
            its training: more anchors and finer borders for more time.
        seed: Same photos, model and seed give the same bytes, on one machine with as many threads.
        device: Where the model runs, such as cuda.
        overwrite: Replace a scene that is already there.
        json: Print the result as one JSON object on stdout.
        timings: Print how long each stage took, on stderr.
    """
    if not photos:
        raise ValueError("no photos were named: give a folder, files, a pattern or a video")
    make_scene(
        photos[0] if len(photos) == 1 else list(photos), output, cameras=cameras,
        geometry=geometry, allow_outside=allow_outside, up=up, model=model, refine=refine,
        clean_up=clean_up, semantics=semantics, teacher=teacher, keep_interrupted=keep_interrupted,
        max_views=max_views, pixels=pixels, seed=seed, device=device, overwrite=overwrite,
        json=json, timings=timings,
    )  # fmt: skip


def make_scene(
    photos: str | Path | Sequence[str | Path],
    output: Path,
    *,
    cameras: Path | None = None,
    geometry: str = "nano",
    allow_outside: bool = False,
    up: tuple[str, ...] | None = None,
    model: Path | None = None,
    refine: int | None = None,
    clean_up: bool = True,
    semantics: str = "auto",
    teacher: str | None = None,
    keep_interrupted: bool = False,
    max_views: int = 16,
    pixels: int | None = None,
    seed: int = 0,
    device: str = "cpu",
    overwrite: bool = False,
    json: bool = False,
    timings: bool = False,
) -> None:
    """Reconstruct, save, and say on stdout what came out."""
    from instok3d.cli.progress import StageClock, plain_warnings
    from instok3d.cli.signals import asked_to_stop

    clock = StageClock()
    with clock.running():
        clock.begin("start")
        from instok3d.cli.info import show_made
        from instok3d.refinement.settings import DEFAULT_STEPS
        from instok3d.scene.files import check_target
        from instok3d.scene.previews import save_with_previews
        from instok3d.scene.reconstruct import reconstruct

        check_target(output, overwrite=overwrite)
        with plain_warnings(), asked_to_stop(when=keep_interrupted) as stop:
            scene = reconstruct(
                photos, cameras=cameras, geometry=geometry, allow_outside=allow_outside, up=up,
                model=model, seed=seed, refine=DEFAULT_STEPS if refine is None else refine,
                clean_up=clean_up, semantics=semantics, teacher=teacher,
                max_views=max_views, pixels=pixels, device=device, progress=clock.begin, stop=stop,
            )  # fmt: skip
        with plain_warnings():
            save_with_previews(scene, output, overwrite=overwrite, progress=clock.begin)
    show_made(scene, output, clock, json=json, timings=timings)
