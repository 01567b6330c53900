"""`instok3d refine`: the Gaussians of a scene optimised on its photos."""

from pathlib import Path
from typing import Annotated

import tyro


def run(
    scene: tyro.conf.Positional[Path],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    photos: Annotated[tuple[str, ...], tyro.conf.arg(metavar="INPUT ...")] = (),
    steps: int | None = None,
    pixels: int | None = None,
    masks: Path | None = None,
    densify: float = 0.0,
    keep_interrupted: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    json: bool = False,
    timings: bool = False,
) -> None:
    """Optimise the Gaussians of a scene on the photos it was made from; objects stay objects.

    Args:
        scene: A scene folder; it stays as it is.
        output: The scene folder to write.
        photos: The photos that the scene was made from, as reconstruct takes them. Without them
            the scene's own copies are used, which have the size that the model saw.
        steps: Of optimisation. None takes the default.
        pixels: Height at which the photos are looked at, such as 256 or 512; more than the
            scene's own needs --photos.
        masks: A folder with masks named as the photos (a.png for a.jpg): black pixels are
            ignored.
        densify: Share of the Gaussians that are split in two where the error stays, such as 0.3.
        keep_interrupted: Ctrl-C ends the refinement there and keeps what is reached; a second one
            ends the command.
        seed: Of the order in which many views are looked at.
        overwrite: Replace a scene that is already there.
        json: Print the result as one JSON object on stdout.
        timings: Print how long each stage took, on stderr.
    """
    from instok3d.cli.progress import StageClock, plain_warnings
    from instok3d.cli.signals import asked_to_stop

    clock = StageClock()
    with clock.running():
        clock.begin("start")
        from instok3d.cli.info import show_made
        from instok3d.refinement.settings import DEFAULT_STEPS
        from instok3d.scene.files import check_target
        from instok3d.scene.previews import save_with_previews
        from instok3d.scene.refine import refine
        from instok3d.scene.scene import Scene

        check_target(output, overwrite=overwrite)
        clock.begin("scene")
        loaded = Scene.load(scene)
        clock.begin("refinement")
        with plain_warnings(), asked_to_stop(when=keep_interrupted) as stop:
            result = refine(
                loaded,
                None if not photos else photos[0] if len(photos) == 1 else list(photos),
                steps=DEFAULT_STEPS if steps is None else steps, pixels=pixels, masks=masks,
                densify=densify, seed=seed, progress=clock.begin, stop=stop,
            )  # fmt: skip
        with plain_warnings():
            save_with_previews(result, output, overwrite=overwrite, progress=clock.begin)
    show_made(result, output, clock, json=json, timings=timings)
