"""`instok3d evaluate`: measure a model on test rooms or on prepared test scenes."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from instok3d.data.batches import Unit
    from instok3d.datasets.prepared import Split
    from instok3d.evaluation.dataset_protocols import DatasetProtocol
    from instok3d.evaluation.prediction import Prediction
    from instok3d.evaluation.protocols import ProtocolScene

Protocol = Literal[
    "rooms-2view",
    "rooms-8view",
    "scannet-2view",
    "scannet-8view",
    "re10k-2view",
    "mipnerf360-2view",
]


def run(
    protocol: tyro.conf.Positional[Protocol],
    /,
    data: Path,
    model: Path | None = None,
    geometry: Literal["predicted", "intrinsics", "given"] | None = None,
    target_cameras: Literal["auto", "true", "aligned"] = "auto",
    scenes: int | None = None,
    targets_per_scene: int = 3,
    index: Path | None = None,
    all_targets: bool = False,
    split: Literal["train", "val", "test"] = "test",
    pose_alignment_steps: int = 0,
    refine: int = 0,
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
            every other frame of 15 and asks for the 7 between. The others are those of LSM and
            Uni3R, pixelSplat, and Uni3R (docs/evaluation.md).
        data: A folder of rooms with seeds 2,000,000 to 2,000,099, from `instok3d data rooms`, or
            of prepared scenes, from `instok3d data prepare`.
        model: A model file instead of the default model.
        geometry: predicted: bare photos. intrinsics: the model is told the true intrinsics too.
            given: it gets true cameras and depth. None: predicted for rooms; intrinsics for the
            others, as in the paper.
        target_cameras: Where targets are rendered. true: at their true cameras. aligned: these,
            brought into the predicted world. auto: true for a model that is told the intrinsics
            and learned to answer in the unit of the scenes, aligned for others.
        scenes: Only the first so many rooms or scenes.
        targets_per_scene: How many i of each room (rooms-2view).
        index: The evaluation index of RealEstate10K, a JSON file (re10k-2view).
        all_targets: Every eighth-frame target of a scene, not its middle one (mipnerf360-2view).
        split: Which prepared scenes; rooms are told by their seeds.
        pose_alignment_steps: Fit each target camera to the target photo first; off as a rule.
        refine: Steps in which the Gaussians are optimised on the context photos first, as
            reconstruct does by default; 0 measures the paper's single forward pass.
        lpips: vgg or alex after 'instok3d models pull lpips', or a file of LPIPS weights; without
            it LPIPS is null.
        baselines: Also measure the nearest photo, the photo warped by depth, colour clusters.
        save: A folder for a picture of each sample: photos, target, render, true and predicted
            masks.
        json: Print one JSON object.
        details: With --json: also settings, levels, baselines and further figures.
        markdown: Print rows for docs/results.md.
    """
    from instok3d.evaluation.instance_ap import ApSettings
    from instok3d.evaluation.report import as_json, as_table
    from instok3d.evaluation.run import EvaluationSettings, evaluate
    from instok3d.files import sha256_of
    from instok3d.model.files import DEFAULT_MODEL, load_model, read_unit
    from instok3d.objectives.lpips import load_lpips
    from instok3d.progress import progress_bar
    from instok3d.refinement.settings import check_steps

    if pose_alignment_steps < 0:
        raise ValueError(f"--pose-alignment-steps must be 0 or more, got {pose_alignment_steps}")
    check_steps(refine)
    if details and not json:
        raise ValueError("--details adds to the JSON object: pass --json too")
    unit = read_unit(model)
    settings = EvaluationSettings(
        geometry=geometry or ("predicted" if protocol.startswith("rooms-") else "intrinsics"),
        target_cameras=target_cameras,
        model_unit=unit,
        pose_alignment_steps=pose_alignment_steps,
        refine=refine,
        ap=ApSettings(min_instance_area=20 if protocol.startswith("rooms-") else 0),
        baselines=baselines,
    )
    distance = None if lpips is None else load_lpips(lpips)
    if protocol in ("rooms-2view", "rooms-8view"):
        total, asked = _rooms(data, protocol, scenes, targets_per_scene, unit)
    else:
        total, asked = _prepared(data, protocol, scenes, index, all_targets, split, unit)
    asked = _checked(asked, model)
    tokenizer = load_model(model)
    if save is not None:
        save.mkdir(parents=True, exist_ok=True)
    file = DEFAULT_MODEL if model is None else model
    with progress_bar(total, unit="scene") as bar:

        def on_scene(scene: "ProtocolScene", predictions: "Sequence[Prediction]") -> None:
            bar.update()
            if save is not None:
                _save_sheets(save, protocol, scene, predictions)

        report = evaluate(
            tokenizer,
            asked,
            settings,
            protocol=protocol,
            model_name=f"{file.name} sha256:{sha256_of(file)[:12]}",
            lpips=distance,
            on_scene=on_scene,
        )
    if json:
        from instok3d.cli.info import print_json

        print_json(as_json(report, details=details))
    elif markdown:
        from instok3d.evaluation.report import results_header, results_rows
        from instok3d.model.files import read_card
        from instok3d.version import current_commit, short

        rows = results_rows(
            report,
            command=" ".join(["instok3d", *sys.argv[1:]]),
            commit=short(current_commit()),
            seed=read_card(model).get("config", {}).get("seed"),
            machine=_machine(),
        )
        print(f"{results_header(report)}\n{rows}")
    else:
        print(as_table(report))


def _checked(asked: "Iterable[ProtocolScene]", model: Path | None) -> "Iterable[ProtocolScene]":
    """The same scenes, the first of which was looked at: would the model fit in memory?"""
    from itertools import chain, islice

    from instok3d.backbones.cost import Work
    from instok3d.model.files import read_sizes
    from instok3d.model.memory import check_memory

    scenes = iter(asked)
    first = list(islice(scenes, 1))
    for scene in first:
        _, views, _, height, width = scene.samples[0].context.images.shape
        work = Work(views, height, width)
        check_memory(*read_sizes(model), work, advice="choose a protocol with fewer")
    return chain(first, scenes)


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
    folder: Path, protocol: str, scene: "ProtocolScene", predictions: "Sequence[Prediction]"
) -> None:
    from instok3d.evaluation.sheet import write_sheet

    kind = "" if scene.level is None else f"{scene.level}_"
    for number, (sample, prediction) in enumerate(zip(scene.samples, predictions, strict=True)):
        name = f"{protocol}_{kind}{scene.name}_{number}.png"
        write_sheet(folder / name, sample, prediction)


def _machine() -> str:
    """Name of the processor and number of usable cores."""
    import os
    import platform

    name = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        lines = information.read_text().splitlines()
        named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
        name = named[0] if named else name
    return f"{name}, {os.cpu_count()} cores"
