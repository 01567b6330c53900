"""`instok3d evaluate`: measure a model on test rooms or on prepared test scenes."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from tqdm import tqdm

    from instok3d.data.batches import Unit
    from instok3d.datasets.prepared import Split
    from instok3d.evaluation.dataset_protocols import DatasetProtocol
    from instok3d.evaluation.prediction import Prediction
    from instok3d.evaluation.protocols import ProtocolScene
    from instok3d.evaluation.run import EvaluationReport

Protocol = Literal[
    "rooms-2view",
    "rooms-8view",
    "scannet-2view",
    "scannet-8view",
    "re10k-2view",
    "mipnerf360-2view",
    "capture",
    "capture-2view",
    "capture-8view",
]
Method = Literal[
    "tokenizer",
    "3dgs",
    "gaussian-grouping",
    "objectgs",
    "label-lifting",
    "uni3r-style",
    "c3g-style",
]
"""The model, and those of baselines/registry.py and feature_files.py, which need PyTorch."""
Tracker = Literal["true-ids", "true-depth", "predicted-depth", "flow2d", "none"]
"""As in baselines/context_masks.py, which needs PyTorch."""
Disturbance = Literal[
    "jpeg30", "noise8", "exposure20", "focal1.33", "focal2", "grey", "overexposed", "hard"
]
"""As in evaluation/disturbances.py, which needs PyTorch."""


def run(
    protocol: tyro.conf.Positional[Protocol],
    /,
    data: Path,
    model: Path | None = None,
    method: Method = "tokenizer",
    method_steps: int | None = None,
    masks: str | None = None,
    tracker: Tracker | None = None,
    geometry: Literal["predicted", "intrinsics", "given"] | None = None,
    target_cameras: Literal["auto", "true", "aligned"] = "auto",
    scenes: int | None = None,
    targets_per_scene: int | None = None,
    frame_step: int = 1,
    frame_pixels: int | None = None,
    pixels: int | None = None,
    outlines: Path | None = None,
    index: Path | None = None,
    all_targets: bool = False,
    split: Literal["train", "val", "test"] = "test",
    pose_alignment_steps: int | None = None,
    refine: int = 0,
    clean_up: bool = False,
    objects: bool = False,
    instances_3d: bool = False,
    costs: bool = False,
    disturb: Disturbance | None = None,
    lpips: str | None = None,
    baselines: bool = False,
    save: Path | None = None,
    json: bool = False,
    details: bool = False,
    markdown: bool = False,
) -> None:
    """Measure pictures, masks, cameras and depth on the test scenes of a data set.

    Args:
        protocol: rooms-2view shows frames i-1 and i+1 and asks for frame i; rooms-8view shows
            every other frame of 15 and asks for the 7 between; capture-2view and capture-8view
            do so with photos of real rooms, capture is both. The others are those of LSM and
            Uni3R, pixelSplat, and Uni3R (docs/evaluation.md).
        data: A folder of rooms with seeds 2,000,000 to 2,000,099, from `instok3d data rooms`, or
            of prepared scenes, from `instok3d data prepare`; or a capture, photos with their
            cameras in scene.json, transforms.json or a COLMAP model, or a folder of captures.
        model: A model file instead of the default model, or hub:USER/NAME@REVISION; of uni3r-style
            and c3g-style the file that was trained and exported.
        method: tokenizer: the model. uni3r-style, c3g-style: other models of one forward pass,
            without instances. The others optimise each scene of rooms or ScanNet, from given
            cameras and depth, and all but 3dgs with masks of the context views.
        method_steps: Of such an optimisation; 600 as a rule.
        masks: For such a method. true: of the data, which is the rule and an upper bound. degraded:
            these, in each view with the faults of a network that segments single photos.
            segmenter:FILE: those that the network of FILE (instok3d train nano-segmenter) finds.
        tracker: How ids of these masks come to hold across views. true-ids: those of the data, the
            rule for true masks. true-depth: by true depth and cameras, the rule for degraded ones.
            predicted-depth: by those that the model predicts of bare photos, the rule for those of
            a segmenter. flow2d: by optical flow between the photos alone (needs OpenCV). none: not
            at all.
        geometry: predicted: bare photos. intrinsics: the model is also given the true intrinsics.
            given: it gets true cameras and depth. None: predicted for rooms and captures;
            intrinsics for the others, as in the paper.
        target_cameras: Where targets are rendered. true: at their true cameras. aligned: these,
            brought into the predicted world. auto: true for a model that is given the intrinsics
            and learned to answer in the unit of the scenes, aligned for others.
        scenes: Only the first so many rooms or scenes.
        targets_per_scene: How many i of each room (rooms-2view), 3 as a rule; the most targets of
            each capture, 100 as a rule.
        frame_step: Only every so many frames of a capture are used.
        frame_pixels: Height of the frames of a capture; that of the model's training as a rule.
        pixels: Height at which the model sees the context photos, instead of that of the targets.
        outlines: A folder of outlines of the objects in photos of captures, for AP, instead of
            those that come with the package (docs/formats.md).
        index: The evaluation index of RealEstate10K, a JSON file (re10k-2view).
        all_targets: Every eighth-frame target of a scene, not its middle one (mipnerf360-2view).
        split: Which prepared scenes; rooms are split by their seeds.
        pose_alignment_steps: Fit each target camera to the target photo first; off as a rule. For
            captures these are figures beside the others, by 25 steps as a rule; 0 leaves them out.
        refine: Steps in which the Gaussians are optimised on the context photos first, as
            reconstruct does by default; 0 measures the paper's single forward pass.
        clean_up: Join groups that hold one thing and give loose pieces to what surrounds them, as
            reconstruct does by default; without it the groups are measured as the model gives them.
        objects: Also measure whether each thing is one whole object in the context views: objects
            for each instance, share of whole ones, purity, instances found, small ones too.
        instances_3d: Also compare instances in space: points of the context views that belong
            together, over all of these views at once (docs/evaluation.md).
        costs: Also measure the most memory that is held while a scene is made, and state it with
            the numbers stored and the times.
        disturb: Do this to the context photos first, always in the same way (docs/evaluation.md);
            the targets stay clean.
        lpips: vgg or alex after 'instok3d models pull lpips', or a file of LPIPS weights; without
            it LPIPS is null.
        baselines: Also measure the nearest photo, the photo warped by depth, colour clusters.
        save: A folder for a picture of each sample, or of each capture: photos, target, render,
            true and predicted masks.
        json: Print one JSON object.
        details: With --json: also settings, levels, baselines and further figures.
        markdown: Print rows for docs/results.md.
    """
    from instok3d.cli.evaluate_captures import ALIGNMENT_STEPS, Run, capture_runs
    from instok3d.cli.evaluate_methods import (
        check_one_pass,
        check_options,
        given_masks_of,
        measured_features,
        measured_method,
        measured_model,
    )
    from instok3d.evaluation.instance_ap import ApSettings
    from instok3d.evaluation.run import EvaluationSettings, evaluate
    from instok3d.hub.references import is_hub
    from instok3d.model.files import read_unit
    from instok3d.objectives.lpips import load_lpips
    from instok3d.progress import progress_bar
    from instok3d.refinement.settings import check_steps
    from instok3d.scene.hub_model import find_model
    from instok3d.scene.reconstruct import checked_side

    if is_hub(model):
        model = find_model(model).path
    of_captures = protocol.startswith("capture")
    bare = of_captures or protocol.startswith("rooms-")
    steps = ALIGNMENT_STEPS * of_captures if pose_alignment_steps is None else pose_alignment_steps
    if steps < 0:
        raise ValueError(f"--pose-alignment-steps must be 0 or more, got {steps}")
    if outlines is not None and not of_captures:
        raise ValueError(f"--outlines are of photos of captures, {protocol} has its own masks")
    if frame_pixels is not None and not of_captures:
        raise ValueError(f"--frame-pixels is of captures, the frames of {protocol} have their size")
    for name, side in (("--frame-pixels", frame_pixels), ("--pixels", pixels)):
        if side is not None:
            checked_side(side, name)
    check_steps(refine)
    if details and not json:
        raise ValueError("--details adds to the JSON object: pass --json too")
    given_masks = given_masks_of(masks, tracker, model)
    of_one_pass = method in ("tokenizer", "uni3r-style", "c3g-style")
    if method in ("uni3r-style", "c3g-style"):
        changed = {
            "--refine": refine > 0,
            "--clean-up": clean_up,
            "--pixels": pixels is not None,
        }
        check_one_pass(method, model, changed)
    if not of_one_pass:
        given = {
            "--model": model is not None and given_masks.settled_tracker != "predicted-depth",
            "--geometry": geometry not in (None, "given"),
            "--refine": refine > 0,
            "--pixels": pixels is not None,
            "--clean-up": clean_up,
        }
        check_options(method, protocol, given)
        geometry = "given"
    elif method_steps is not None or masks is not None or tracker is not None:
        raise ValueError(
            "--method-steps, --masks and --tracker are of a method that optimises each scene: "
            "add --method of one"
        )
    unit = read_unit(model) if method == "tokenizer" else None
    settings = EvaluationSettings(
        geometry=geometry or ("predicted" if bare else "intrinsics"),
        target_cameras=target_cameras,
        model_unit=unit,
        pose_alignment_steps=0 if of_captures else steps,
        also_aligned=steps if of_captures else 0,
        refine=refine,
        clean_up=clean_up,
        ap=ApSettings(min_instance_area=20 if bare else 0),
        baselines=baselines,
        id_agreement=of_captures,
        objects=objects,
        instances_3d=instances_3d,
        pixels=pixels,
        costs=costs,
        disturb=disturb,
    )
    distance = None if lpips is None else load_lpips(lpips)
    if protocol in ("capture", "capture-2view", "capture-8view"):
        runs = capture_runs(
            data, protocol, model=model, num_captures=scenes, targets_per_scene=targets_per_scene,
            frame_step=frame_step, frame_pixels=frame_pixels, outlines=outlines, unit=unit,
        )  # fmt: skip
    elif protocol in ("rooms-2view", "rooms-8view"):
        most = 3 if targets_per_scene is None else targets_per_scene
        runs = [Run(protocol, *_rooms(data, protocol, scenes, most, unit))]
    else:
        runs = [Run(protocol, *_prepared(data, protocol, scenes, index, all_targets, split, unit))]
    measured = None
    reports = []
    for each in runs:
        asked = _checked(each.scenes, model, pixels) if method == "tokenizer" else each.scenes
        if asked is None and of_captures:
            continue  # each was left out with a warning; the other protocol may have some
        if measured is None:
            if method == "tokenizer":
                measured = measured_model(model)
            elif method in ("uni3r-style", "c3g-style"):
                measured = measured_features(method, model, settings.geometry)
            else:
                measured = measured_method(method, method_steps, given_masks)
        if save is not None:
            save.mkdir(parents=True, exist_ok=True)
        with progress_bar(each.total, unit="scene") as bar:

            def on_scene(
                scene: "ProtocolScene",
                predictions: "Sequence[Prediction]",
                name: str = each.protocol,
                bar: "tqdm" = bar,
            ) -> None:
                bar.update()
                if save is not None:
                    _save_sheets(save, name, scene, predictions, one=of_captures)

            reports.append(
                evaluate(
                    measured.method,
                    asked or (),
                    settings,
                    protocol=each.protocol,
                    model_name=measured.name,
                    lpips=distance,
                    masks_of=measured.masks_of,
                    on_scene=on_scene,
                )
            )
    if not reports or measured is None:
        raise ValueError(f"no capture in {data} can be measured by {protocol}: see the warnings")
    form = "json" if json else "markdown" if markdown else "table"
    _print(protocol, reports, form=form, details=details, seed=measured.seed)


def _print(
    protocol: Protocol,
    reports: "Sequence[EvaluationReport]",
    *,
    form: Literal["json", "markdown", "table"],
    details: bool,
    seed: int | None,
) -> None:
    from instok3d.evaluation.report import as_json, as_table, results_header, results_rows

    if form == "json":
        from instok3d.cli.info import print_json

        values = {each.protocol: as_json(each, details=details) for each in reports}
        print_json(values.get(protocol, {"protocol": protocol, **values}))
    elif form == "markdown":
        from instok3d.tables.machine import machine_name
        from instok3d.version import current_commit, short

        print(results_header(reports[0]))
        for each in reports:
            rows = results_rows(
                each,
                command=" ".join(["instok3d", *sys.argv[1:]]),
                commit=short(current_commit()),
                seed=seed,
                machine=machine_name(),
            )
            print(rows)
    else:
        print("\n\n".join(as_table(each) for each in reports))


def _checked(
    asked: "Iterable[ProtocolScene]", model: Path | None, pixels: int | None
) -> "Iterable[ProtocolScene] | None":
    """The same scenes, the first of which was looked at: would the model fit in memory?

    None if there is no scene.
    """
    from itertools import chain, islice

    from instok3d.backbones.cost import Work
    from instok3d.model.files import read_sizes
    from instok3d.model.memory import check_memory

    scenes = iter(asked)
    first = list(islice(scenes, 1))
    for scene in first:
        _, views, _, height, width = scene.samples[0].context.images.shape
        if pixels is not None:
            height, width = pixels, round(pixels * width / height)
        work = Work(views, height, width)
        check_memory(*read_sizes(model), work, advice="choose a protocol with fewer")
    return chain(first, scenes) if first else None


def _rooms(
    data: Path,
    protocol: Literal["rooms-2view", "rooms-8view"],
    num_scenes: int | None,
    targets_per_scene: int,
    unit: "Unit | None",
) -> tuple[int, "Iterable[ProtocolScene]"]:
    """How many test rooms there are to measure, and those rooms."""
    from instok3d.evaluation.protocols import protocol_rooms, room_indices
    from instok3d.rooms import RoomDataset
    from instok3d.rooms.shards import read_index

    dataset = RoomDataset(data)
    seeds = [dataset.seed_of(number) for number in range(len(dataset))]
    shards = read_index(data)["shards"].values()
    rejected = {seed for shard in shards for seed in shard["rejected"]}
    indices = room_indices(seeds, rejected=rejected, num_scenes=num_scenes)
    rooms = protocol_rooms(
        dataset, indices, protocol, targets_per_scene=targets_per_scene, model_unit=unit
    )
    return len(indices), rooms


def _prepared(
    data: Path,
    protocol: "DatasetProtocol",
    num_scenes: int | None,
    index: Path | None,
    all_targets: bool,
    split: "Split",
    unit: "Unit | None",
) -> tuple[int, "Iterable[ProtocolScene]"]:
    """How many prepared scenes there are to look at, and those that the protocol can use."""
    from instok3d.datasets.prepared import PreparedScenes
    from instok3d.evaluation.dataset_protocols import (
        frame_chooser,
        protocol_scenes,
        read_re10k_index,
    )

    entries = None if index is None else read_re10k_index(index)
    choose = frame_chooser(protocol, re10k_index=entries, all_targets=all_targets)
    prepared = PreparedScenes(data, splits=(split,))
    total = min(len(prepared), num_scenes or len(prepared))
    asked = protocol_scenes(prepared, protocol, choose, num_scenes=num_scenes, model_unit=unit)
    return total, asked


def _save_sheets(
    folder: Path,
    protocol: str,
    scene: "ProtocolScene",
    predictions: "Sequence[Prediction]",
    *,
    one: bool,
) -> None:
    """A picture of each sample, or one of them all."""
    from instok3d.evaluation.sheet import write_scene_sheet, write_sheet

    if one:
        write_scene_sheet(folder / f"{protocol}_{scene.name}.png", scene.samples, predictions)
        return
    kind = "" if scene.level is None else f"{scene.level}_"
    for number, (sample, prediction) in enumerate(zip(scene.samples, predictions, strict=True)):
        name = f"{protocol}_{kind}{scene.name}_{number}.png"
        write_sheet(folder / name, sample, prediction)
