"""`instok3d data masks`: instance ids for footage that has none."""

import json as json_module
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

if TYPE_CHECKING:
    from instok3d.datasets.pseudo_labels.writing import Clip, LabelConfig, Labelled, LabelModel

FAILED = 2
"""Exit code when scenes could not be labelled."""


def masks(
    folder: Positional[Path],
    output: Annotated[Path | None, arg(aliases=["-o"])] = None,
    model: Literal["sam2"] = "sam2",
    size: Literal["tiny", "small", "base-plus", "large"] = "large",
    weights: Path | None = None,
    scenes: tuple[str, ...] = (),
    keyframe_step: int = 10,
    points_per_side: int = 32,
    reentry_frames: int = 0,
    device: str = "cpu",
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Find the things in clips and follow them: one 16-bit id map a frame, 0 = nothing.

    Every scene of a prepared folder gets a folder masks_sam2 that training reads. Run it again to
    go on after a stop. masks.json has the settings, the weights' hash and how well the ids hold.

    Args:
        folder: Written by `instok3d data prepare`, or a folder of consecutive pictures.
        output: For a folder of pictures: a new folder for the id maps.
        model: What proposes and tracks masks.
        size: Of SAM 2.1; the weights come by `instok3d models pull sam2.1-SIZE`.
        weights: Folder with config.json and model.safetensors to use instead.
        scenes: Only these of a prepared folder.
        keyframe_step: New masks are looked for on every so many frames.
        points_per_side: The grid of points that the model is asked about.
        reentry_frames: Give a new mask the id of a track lost so many frames ago or fewer at the
            same place of the picture; for cameras that stand still.
        device: Where the model runs, such as cuda.
        overwrite: Make masks anew that are there.
        json: Print the figures of every clip as JSON.
    """
    from instok3d.cli.progress import plain_warnings
    from instok3d.datasets.pseudo_labels.association import AssociationConfig
    from instok3d.datasets.pseudo_labels.automatic import AutomaticConfig
    from instok3d.datasets.pseudo_labels.sam2 import Sam2
    from instok3d.datasets.pseudo_labels.writing import LabelConfig

    automatic = AutomaticConfig(points_per_side=points_per_side)
    association = AssociationConfig(keyframe_step=keyframe_step, reentry_frames=reentry_frames)
    clips, unreadable = _clips(folder, output, model, scenes)
    with plain_warnings():
        labeller = Sam2(_weights_folder(weights, size), automatic, device)
        done, failed = _label_all(clips, labeller, LabelConfig(association), overwrite=overwrite)
    failed |= unreadable
    print(_as_json(done, failed) if json else _as_table(done, failed))
    return FAILED if failed else 0


def _clips(
    folder: Path, output: Path | None, model: str, wanted: tuple[str, ...]
) -> "tuple[dict[str, Clip], dict[str, str]]":
    """The clips of a folder by name, and what is wrong with those that cannot be read."""
    from instok3d.datasets.prepared import scene_folders
    from instok3d.datasets.pseudo_labels.writing import footage_clip, scene_clip
    from instok3d.photos.image_files import find_images

    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    prepared = {scene.name: scene for scene in scene_folders(folder)}
    if not prepared:
        if output is None:
            raise ValueError(
                f"{folder} is no folder of `instok3d data prepare`; for a folder of pictures pass "
                "-o, a new folder for the id maps"
            )
        if wanted:
            raise ValueError(f"--scenes chooses from a prepared folder, and {folder} is none")
        return {folder.name: footage_clip(find_images(folder), output)}, {}
    if output is not None:
        raise ValueError(
            f"{folder} is a prepared folder: its masks go into it, -o is for a folder of pictures"
        )
    unknown = [name for name in wanted if name not in prepared]
    if unknown:
        raise KeyError(f"{folder} has no scene {unknown[0]}; it has {', '.join([*prepared][:5])}")
    clips: dict[str, Clip] = {}
    unreadable: dict[str, str] = {}
    for name in wanted or prepared:
        try:
            clips[name] = scene_clip(prepared[name], model)
        except ValueError as error:
            unreadable[name] = str(error)
            print(f"instok3d: {name}: {error}", file=sys.stderr)
    return clips, unreadable


def _weights_folder(given: Path | None, size: str) -> Path:
    from instok3d.weights import weights_path

    return weights_path(f"sam2.1-{size}").parent if given is None else given


def _label_all(
    clips: "dict[str, Clip]", model: "LabelModel", config: "LabelConfig", *, overwrite: bool
) -> "tuple[dict[str, Labelled], dict[str, str]]":
    """Label clip after clip; what went wrong with one does not stop the others."""
    from instok3d.datasets.pseudo_labels.writing import label
    from instok3d.progress import progress_bar

    done: dict[str, Labelled] = {}
    failed: dict[str, str] = {}
    total = sum(len(clip.images) for clip in clips.values())
    with progress_bar(total, unit="frame") as bar:
        for number, (name, clip) in enumerate(clips.items(), start=1):
            bar.set_description(name)
            try:
                done[name] = label(clip, model, config, overwrite=overwrite, progress=bar.update)
            except (ValueError, FileNotFoundError, FileExistsError) as error:
                failed[name] = str(error)
                print(f"instok3d: {name}: {error}", file=sys.stderr)
            else:
                bar.write(f"{number}/{len(clips)} {name}: {done[name].outcome}", file=sys.stderr)
    return done, failed


def _as_json(done: "dict[str, Labelled]", failed: dict[str, str]) -> str:
    clips = {
        name: {"folder": str(each.folder), "outcome": each.outcome, **asdict(each.statistics)}
        for name, each in done.items()
    }
    return json_module.dumps({"clips": clips, "failed": failed}, indent=2)


def _as_table(done: "dict[str, Labelled]", failed: dict[str, str]) -> str:
    lines = []
    for name, each in done.items():
        s = each.statistics
        lines.append(
            f"{name}: {s.frames} frames, {s.tracks} ids of {s.mean_track_frames:.1f} frames, "
            f"{100 * s.coverage:.0f} % covered, {s.breaks} breaks, {s.flickers} flickers, "
            f"{s.returns} returns ({each.outcome})"
        )
    made = sum(each.outcome == "made" for each in done.values())
    lines.append(f"{made} clips labelled, {len(done) - made} there already, {len(failed)} failed")
    return "\n".join(lines)
