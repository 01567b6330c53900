"""Finding ScanNet scans on the disk, in any of three layouts, as jobs of preparation."""

import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from instok3d.datasets.preparation import (
    SPLIT_RULE,
    Frames,
    LeftOutError,
    SceneJob,
    estimate_bytes,
)
from instok3d.datasets.prepared import PreparedFrame, SceneInfo, Split
from instok3d.datasets.scannet.export import scan_frames
from instok3d.datasets.scannet.exported import FileTree, lsm_frames, processed_frames
from instok3d.datasets.scannet.sens import FRAME_HEAD_BYTES, SensFile
from instok3d.datasets.scannet.splits import (
    POSE_FRAMES,
    SCAN_NAME,
    TEST_LIST,
    TEST_POOL,
    SceneList,
    fallback_test_scenes,
    published_test_scenes,
    split_of,
)


@dataclass(frozen=True)
class ScanNetSource:
    """ScanNet scans below a folder; a `PreparationSource`.

    Three layouts are known by what lies there: `[scans/]{scan}/{scan}.sens` with its archives,
    Uni3R's `[scannet_processed/]{scan}/color, depth, pose`, and LSM's `[scannet_test/]{scan}/
    images, depths, labels`, also inside its tar file.
    """

    folder: Path
    """Of the scans, or LSM's tar file."""
    size: int = 256
    """Height and width of the prepared frames."""
    stride: int = 10
    """Of a .sens scan frames 0, stride, 2 stride, ... are taken (Uni3R and LSM: 10)."""
    instances: bool = True
    """Read `{scan}_2d-instance-filt.zip`; a scan without it fails."""
    labels: bool = True
    """Read `{scan}_2d-label-filt.zip`; a scan without it fails."""
    splits: tuple[Split, ...] = ("train", "val", "test")
    """Scans of other splits are left out."""
    min_frames: int = 33
    """Training and validation scans of fewer prepared frames are left out (Uni3R: 32 or fewer)."""

    def __post_init__(self):
        sizes = (self.size, self.stride, self.min_frames)
        if min(sizes) < 1:
            raise ValueError(f"size, stride and min_frames must be 1 or more, got {sizes}")

    def jobs(self) -> Sequence[SceneJob]:
        """All scans of the wanted splits, by name.

        Raises:
            FileNotFoundError: There is no such folder, or no scan in it.
            ValueError: No scan is of the wanted splits, or the list of test scenes is damaged.
        """
        if not self.folder.exists():
            raise FileNotFoundError(f"there is no folder {self.folder}")
        jobs = self._raw_jobs() or self._processed_jobs() or self._lsm_jobs()
        if not jobs:
            raise FileNotFoundError(
                f"{self.folder} holds no ScanNet scans; wanted [scans/]SCAN/SCAN.sens, "
                "[scannet_processed/]SCAN/pose/*.npz, or scannet_test[.tar] with "
                "SCAN/images/*.npz"
            )
        kept = [job for job in jobs if job.info.split in self.splits]
        if not kept:
            raise ValueError(
                f"none of the {len(jobs)} scans in {self.folder} is of the splits "
                f"{', '.join(self.splits)}"
            )
        return kept

    def _raw_jobs(self) -> list[SceneJob]:
        scans = {path.stem: path for path in _lying(self.folder, "scans", "*.sens")}
        if not scans:
            return []
        _warn_of_scans_without_sens(scans)
        test = _raw_test_scenes(self.folder, scans)
        layers = ["images", "depths"] + self.instances * ["instances"] + self.labels * ["labels"]
        settings = {"layout": "sens", "stride": self.stride, "layers": layers}
        return [
            self._job(
                name, split, test, settings, layers,
                -(-_frame_count(scans[name]) // self.stride),
                partial(_raw_frames, scans[name], self),
            )
            for name, split in _splits_of(scans, test).items()
        ]  # fmt: skip

    def _processed_jobs(self) -> list[SceneJob]:
        if not self.folder.is_dir():
            return []
        scans = {p.parent.name: p.parent for p in _lying(self.folder, "scannet_processed", "pose")}
        test = fallback_test_scenes({})
        return [
            self._job(
                name, split, test, {"layout": "processed"}, ("images", "depths"),
                sum(1 for _ in (scans[name] / "color").glob("*")),
                partial(processed_frames, scans[name].parent, name, size=self.size),
            )
            for name, split in _splits_of(scans, test).items()
        ]  # fmt: skip

    def _lsm_jobs(self) -> list[SceneJob]:
        names = FileTree(self.folder).names
        cameras = [PurePosixPath(name) for name in names]
        cameras = [p for p in cameras if p.suffix == ".npz" and p.parent.name == "images"]
        counts = Counter(path.parents[1] for path in cameras)
        if not counts:
            return []
        below = min(counts).parent
        test, chosen = _lsm_test_scenes(self.folder, below, names)
        return [
            self._job(
                scan.name, "test", test, {"layout": "lsm"}, ("images", "depths", "labels"), count,
                partial(
                    lsm_frames, self.folder, scan.as_posix(), chosen.get(scan.name), size=self.size
                ),
            )
            for scan, count in sorted(counts.items())
            if scan.name in test.names
        ]  # fmt: skip

    def _job(
        self, name: str, split: Split, test: SceneList, settings: dict[str, Any],
        layers: Sequence[str], num_frames: int, frames: Callable[[], Frames],
    ) -> SceneJob:  # fmt: skip
        settings = settings | {"size": self.size, SPLIT_RULE: test.rule}
        info = SceneInfo(name, "scannet", split, "metre", settings)
        if split != "test":
            frames = partial(_long_enough, frames, self.min_frames)
        return SceneJob(info, estimate_bytes(num_frames, self.size, self.size, layers), frames)


def _lying(folder: Path, usual: str, name: str) -> list[Path]:
    """`{scan}/{name}` in the folder, in its usual subfolder, or with the folder as the scan."""
    places = (folder.glob(f"*/{name}"), folder.glob(f"{usual}/*/{name}"), folder.glob(name))
    return next((found for place in places if (found := sorted(place))), [])


def _warn_of_scans_without_sens(scans: dict[str, Path]) -> None:
    places = {sens.parent.parent for name, sens in scans.items() if sens.parent.name == name}
    folders = {path.name for place in places for path in place.iterdir() if path.is_dir()}
    lacking = sorted(n for n in folders - scans.keys() if SCAN_NAME.fullmatch(n))
    if lacking:
        warnings.warn(
            f"{len(lacking)} scans are left out because their folders have no .sens, such as "
            f"{lacking[0]}; download them",
            stacklevel=4,
        )


def _raw_frames(sens: Path, source: ScanNetSource) -> Frames:
    """The frames of one scan; its archives are looked for beside it."""
    name = sens.stem
    aggregation = sens.with_name(f"{name}.aggregation.json")
    return scan_frames(
        sens,
        stride=source.stride,
        size=source.size,
        instances=sens.with_name(f"{name}_2d-instance-filt.zip") if source.instances else None,
        labels=sens.with_name(f"{name}_2d-label-filt.zip") if source.labels else None,
        aggregation=aggregation if source.instances and aggregation.is_file() else None,
    )


def _long_enough(read: Callable[[], Frames], min_frames: int) -> Frames:
    """The frames of a scan, which is found too short when they are counted."""
    count = 0
    for frame in read():
        count += isinstance(frame, PreparedFrame)
        yield frame
    if 0 < count < min_frames:
        raise LeftOutError(f"fewer than {min_frames} frames (--min-frames)")


def _frame_count(sens: Path) -> int:
    try:
        with SensFile(sens, num_frames=0) as scan:
            fits = scan.frame_count * FRAME_HEAD_BYTES <= sens.stat().st_size
            return scan.frame_count if fits else 0
    except ValueError:
        return 0  # its job will say what is wrong


def _raw_test_scenes(folder: Path, scans: dict[str, Path]) -> SceneList:
    published = folder / TEST_LIST
    if published.is_file():
        return published_test_scenes(published.read_bytes(), str(published))[0]
    checked = {name: _has_finite_poses(scans[name]) for name in TEST_POOL if name in scans}
    return fallback_test_scenes({name: ok for name, ok in checked.items() if ok is not None})


def _has_finite_poses(sens: Path) -> bool | None:
    try:
        with SensFile(sens, num_frames=POSE_FRAMES[-1] + 1) as scan:
            return all(
                np.isfinite(f.world_from_cam).all() for f in scan.frames[:: POSE_FRAMES.step]
            )
    except ValueError:
        return None  # cut off; its job will say so


def _lsm_test_scenes(
    folder: Path, below: PurePosixPath, names: Iterable[str]
) -> tuple[SceneList, dict[str, list[str]]]:
    name = (below / TEST_LIST).as_posix()
    if name not in names:
        return fallback_test_scenes({}), {}
    return published_test_scenes(FileTree(folder).read(name), f"{folder}: {name}")


def _splits_of(scans: Collection[str], test: SceneList) -> dict[str, Split]:
    splits: dict[str, Split] = {}
    others: list[str] = []
    for name in sorted(scans):
        split = split_of(name, test.names)
        if split is None:
            others.append(name)
        else:
            splits[name] = split
    if others:
        warnings.warn(
            f"{len(others)} scans are left out because their names are not among ScanNet's "
            f"annotated scene0000_00 to scene0706_00, such as {others[0]}",
            stacklevel=5,
        )
    return splits
