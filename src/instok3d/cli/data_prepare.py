"""`instok3d data prepare`: real data sets as folders that training reads."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg, subcommand

from instok3d.cli.progress import plain_warnings
from instok3d.datasets.colmap_scenes import ColmapSource, MipNeRF360Source
from instok3d.datasets.footage import FootageSource
from instok3d.datasets.preparation import PreparationReport, plan_preparation
from instok3d.datasets.preparation import prepare as prepare_scenes
from instok3d.datasets.re10k import Re10kSource
from instok3d.datasets.scannet.source import ScanNetSource

FAILED = 2
"""Exit code when scenes could not be prepared."""


@dataclass(frozen=True, kw_only=True)
class RunArguments:
    """Where prepared scenes go."""

    output: Annotated[Path, arg(aliases=["-o"])]
    """Prepared folder; made if it is not there. Scenes that it holds are not made again."""
    workers: int = 2
    """Processes; one a free core."""
    dry_run: bool = False
    """Only say what there is to do and how much disk it takes."""


@dataclass(frozen=True)
class ScanNetArguments(ScanNetSource, RunArguments):
    """ScanNet: .sens scans, the scannet_processed export, or LSM's test scenes."""

    folder: Positional[Path]  # pyright: ignore[reportGeneralTypeIssues]
    """Folder of scans, or LSM's scannet_test.tar."""


@dataclass(frozen=True)
class Re10kArguments(Re10kSource, RunArguments):
    """RealEstate10K: .torch chunks, or camera files with their frames."""

    folder: Positional[Path]  # pyright: ignore[reportGeneralTypeIssues]
    """Folder of the chunks or camera files, or of train/ and test/ with them."""


@dataclass(frozen=True)
class MipNeRF360Arguments(MipNeRF360Source, RunArguments):
    """MipNeRF360: scenes with sparse/0 and images_4."""

    folder: Positional[Path]  # pyright: ignore[reportGeneralTypeIssues]
    """Folder of the scenes, or one of them."""


@dataclass(frozen=True)
class ColmapArguments(ColmapSource, RunArguments):
    """Any scenes with a COLMAP model, binary or text."""

    folder: Positional[Path]  # pyright: ignore[reportGeneralTypeIssues]
    """One scene, or a folder of scenes."""


@dataclass(frozen=True)
class FootageArguments(FootageSource, RunArguments):
    """Your own photos of one room, with id maps and cameras where you have them."""

    folder: Positional[Path]  # pyright: ignore[reportGeneralTypeIssues]
    """Of photos; or a video, or a folder with photos and cameras as scanners leave them."""


Arguments = (
    Annotated[ScanNetArguments, subcommand("scannet")]
    | Annotated[Re10kArguments, subcommand("re10k")]
    | Annotated[MipNeRF360Arguments, subcommand("mipnerf360")]
    | Annotated[ColmapArguments, subcommand("colmap")]
    | Annotated[FootageArguments, subcommand("footage")]
)


def prepare(arguments: Annotated[Arguments, arg(name="")]) -> int:
    """Bring a data set into a folder that training reads; run it again to go on after a stop."""
    with plain_warnings():
        return _prepare(arguments)


def _prepare(arguments: Arguments) -> int:
    plan = plan_preparation(arguments.jobs(), arguments.output)
    print(
        f"{len(plan.jobs)} scenes to prepare, {plan.skipped} already there; about "
        f"{plan.estimated_bytes / 1e9:.2f} GB in {plan.folder}, {plan.free_bytes / 1e9:.2f} GB "
        "are free",
        file=sys.stderr,
    )
    if arguments.dry_run:
        return 0
    report = prepare_scenes(plan, workers=arguments.workers)
    print(_summary(report, arguments.output))
    return FAILED if report.failed else 0


def _summary(report: PreparationReport, folder: Path) -> str:
    lines = [
        f"{folder}: {report.scenes} new scenes of {report.frames} frames, "
        f"{report.num_bytes / 1e9:.2f} GB; {report.skipped} were already there"
    ]
    lines += [f"dropped {n} frames: {reason}" for reason, n in sorted(report.dropped.items())]
    lines += [f"left out {n} scenes: {reason}" for reason, n in sorted(report.left_out.items())]
    lines += [f"failed {name}: {reason}" for name, reason in sorted(report.failed.items())]
    return "\n".join(lines)
