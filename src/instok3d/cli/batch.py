"""`instok3d batch`: many scenes at once, from a folder of folders of photos."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from instok3d.batch.executor import Executor


def run(
    photos: tyro.conf.Positional[Path],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    workers: int | None = None,
    ray: str | None = None,
    library: str | None = None,
    model: Path | None = None,
    geometry: Literal["nano", "da3-small", "da3-base", "vggt-1b", "colmap", "auto"] = "nano",
    refine: int | None = None,
    clean_up: bool = True,
    max_views: int = 16,
    pixels: int | None = None,
    seed: int = 0,
    device: str = "cpu",
    json: bool = False,
) -> int:
    """Make a scene of each subfolder of photos, and of each video; run it again to go on.

    Scenes that are there stay, unless their photos were changed. A scene that fails is named and
    ends nothing; the exit code is then 2. So it is where a scene cannot go into the library.

    Args:
        photos: A folder with a subfolder of photos, or a video, for each scene.
        output: Folder for NAME.itk, batch.json with all results, and contact_sheet.jpg.
        workers: Processes; each loads the model once and keeps it. One, or one for each machine of
            a Ray cluster.
        ray: Work on this Ray cluster: HOST:PORT, `auto` for the one of this machine, or `local`.
            Its machines need this package, and the folders at the same places.
        library: Add each scene to this library, as `instok3d library add` does.
        model: A model file instead of the default model, or hub:USER/NAME@REVISION.
        geometry: As in `instok3d reconstruct`.
        refine: As in `instok3d reconstruct`.
        clean_up: As in `instok3d reconstruct`.
        max_views: Of more photos, this many are chosen to cover all.
        pixels: As in `instok3d reconstruct`.
        seed: Same photos, model and seed give the same bytes, with as many threads.
        device: Where the model runs, such as cuda.
        json: Print one JSON object.
    """
    from instok3d.batch.run import run_batch
    from instok3d.batch.scenes import Options
    from instok3d.cli.progress import plain_warnings
    from instok3d.hub.references import is_hub
    from instok3d.scene.hub_model import find_model

    if is_hub(model):  # once, so that all scenes are made with the same one
        with plain_warnings():
            model = Path(find_model(model).name)
    if ray is not None:  # its processes work elsewhere
        photos, output = photos.absolute(), output.absolute()
        model = model if model is None or is_hub(model) else model.absolute()
    if pixels is not None:
        from instok3d.scene.reconstruct import checked_side

        checked_side(pixels)  # once, not as the failure of every scene
    options = Options(model, geometry, refine, clean_up, max_views, pixels, seed, device)
    with plain_warnings(), _executor(ray, workers, device) as executor:
        batch = run_batch(
            photos, output, options, executor=executor, say=_say,
            keep=None if library is None else partial(_keep, library),
        )  # fmt: skip
    done = len(batch.results) - len(batch.failed)
    if json:
        from dataclasses import asdict

        from instok3d.cli.info import print_json

        scenes = {name: asdict(each) for name, each in batch.results.items()}
        print_json({"output": str(output), "made": batch.made, "done": done,
                    "failed": len(batch.failed), "not_in_library": list(batch.not_kept),
                    "scenes": scenes})  # fmt: skip
    else:
        print(
            f"{output}: {done} scenes, {len(batch.failed)} failed, {batch.made} tried in this run"
        )
    return 2 if batch.failed or batch.not_kept else 0


@contextmanager
def _executor(ray: str | None, workers: int | None, device: str) -> "Iterator[Executor]":
    """Processes of this machine, or of a cluster during the block."""
    from instok3d.batch.pool import Processes
    from instok3d.batch.ray_actors import ray_actors

    if ray is None:
        yield Processes(1 if workers is None else workers)
        return
    with ray_actors(ray, workers, needs_gpu=device.startswith("cuda")) as executor:
        yield executor


def _keep(library: str, place: Path, made: bool) -> None:
    """Add a scene to a library: one of this run, or one that it lacks."""
    from instok3d.library.adding import add_scene, holds_scene

    if made or not holds_scene(library, place):
        add_scene(library, place)


def _say(line: str) -> None:
    from instok3d.progress import CLEAR

    print(f"{CLEAR if sys.stderr.isatty() else ''}instok3d: failed: {line}", file=sys.stderr)
