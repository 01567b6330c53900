"""Captures of real rooms as test scenes: photos with their cameras, and depth where a sensor was.

A capture is a folder that `photos.captures` understands: a scene.json or transforms.json with its
photos and depth, or a COLMAP model with its photos. Nothing has to be prepared.
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from instok3d.data.batches import NoBaselineError, Unit, make_sample
from instok3d.data.scenes import SceneFrames
from instok3d.data.view_sampling import FrameChoice, eight_view_protocol
from instok3d.datasets.footage import check_metric_depth, photo_files
from instok3d.datasets.posed_photos import PhotoFiles, prepared_photo
from instok3d.evaluation.outlines import PhotoOutlines
from instok3d.evaluation.protocols import ProtocolScene, frame_choices
from instok3d.files import sha256_of
from instok3d.photos.camera_files import camera_files_in, read_cameras
from instok3d.photos.captures import find_photos_and_cameras
from instok3d.photos.file_names import shortened
from instok3d.photos.image_decoding import own_pixel_limit
from instok3d.photos.image_files import natural_key

CaptureProtocol = Literal["capture-2view", "capture-8view"]

FRAMES_NEEDED: dict[CaptureProtocol, int] = {"capture-2view": 3, "capture-8view": 15}

MAX_TARGETS = 100
"""Of one capture, unless another number is asked for: all its samples are held in memory."""

UNREADABLE = (ValueError, FileNotFoundError, PermissionError)
"""What readers raise for a capture that they cannot use."""


@dataclass(frozen=True)
class Capture:
    """The frames of one capture, of which no pixel was read yet; a `SceneSource` of one scene."""

    name: str
    """Of its folder."""
    frames_on_disk: tuple[PhotoFiles, ...]
    """In the natural order of the photos' paths; each has a camera."""
    metric: bool
    """Whether cameras and depth are in metres."""
    side: int
    """Height and width of the frames, pixels."""
    outlines: Mapping[str, PhotoOutlines]
    """By the SHA-256 of the photo."""

    def __len__(self) -> int:
        return 1

    def name_of(self, number: int, /) -> str:
        """The name of the capture."""
        return self.name

    def num_frames(self, number: int, /) -> int:
        """How many frames it has."""
        return len(self.frames_on_disk)

    def frames(self, number: int, chosen: Sequence[int], /) -> SceneFrames:
        """These frames: cropped about the principal point, free of lens distortion.

        A frame without outlines has the id -1 everywhere.

        Raises:
            FileNotFoundError: A photo or its depth is not there.
            ValueError: A file is damaged or does not fit its camera; or outlines are for a photo
                of another size.
        """
        with own_pixel_limit():
            read = [self._frame(self.frames_on_disk[index]) for index in chosen]
        images, ids, depths, world_from_cam, intrinsics = zip(*read, strict=True)
        return SceneFrames(
            name=self.name,
            images=torch.from_numpy(np.stack(images)),
            instances=torch.from_numpy(np.stack(ids)),
            depths_m=torch.from_numpy(np.stack(depths)),
            world_from_cam=torch.from_numpy(np.stack(world_from_cam)),
            intrinsics=torch.from_numpy(np.stack(intrinsics)),
        )

    def _frame(self, files: PhotoFiles) -> tuple[np.ndarray, ...]:
        outlines = self.outlines.get(sha256_of(files.photo))
        if outlines is not None:
            files = replace(files, ids=outlines.id_map())
        frame = prepared_photo(files, self.side)
        shape = (self.side, self.side)
        ids, depth = frame.instances, frame.depth_thousandths
        assert frame.world_from_cam is not None
        assert frame.intrinsics is not None
        return (
            frame.image,
            np.full(shape, -1) if ids is None else ids.astype(np.int64),
            np.zeros(shape, np.float32) if depth is None else depth.astype(np.float32) / 1000,
            frame.world_from_cam,
            frame.intrinsics,
        )


def find_captures(folder: Path) -> list[Path]:
    """The captures that a folder is or holds, in natural order; other folders in it are named.

    Raises:
        FileNotFoundError: There is no such folder, or no capture in it.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    if camera_files_in(folder):
        return [folder]
    folders = sorted((path for path in folder.iterdir() if path.is_dir()), key=natural_key)
    found = [path for path in folders if camera_files_in(path)]
    if not found:
        raise FileNotFoundError(
            f"{folder} holds no capture: wanted photos with their cameras in scene.json, "
            "transforms.json or COLMAP's sparse/0, here or in its folders"
        )
    others = [path.name for path in folders if path not in found and path.name[0] != "."]
    if others:
        warnings.warn(
            f"{len(others)} of {len(folders)} folders in {folder} hold no cameras and are left "
            f"out: {shortened(others)}",
            stacklevel=2,
        )
    return found


def read_capture(
    folder: Path,
    *,
    side: int,
    outlines: Mapping[str, PhotoOutlines] | None = None,
    frame_step: int = 1,
) -> Capture:
    """What a capture consists of; its cameras are read and its depth is checked against them.

    Args:
        folder: Photos with their cameras.
        side: Height and width that frames are brought to.
        outlines: See `outlines.read_outlines`; None for none.
        frame_step: Only every so many frames are used, from the first one on.

    Raises:
        FileNotFoundError: Something that the camera file names is not there.
        ValueError: The cameras cannot be used, the depth does not fit them, or frame_step is
            below 1.
    """
    if frame_step < 1:
        raise ValueError(f"the step between frames must be at least 1, got {frame_step}")
    known = read_cameras(folder)
    photos, cameras = find_photos_and_cameras(folder, known.source)
    photos = sorted(photos, key=natural_key)[::frame_step]
    frames = photo_files(photos, cameras)
    check_metric_depth(frames)
    return Capture(
        name=folder.absolute().name,
        frames_on_disk=tuple(frames),
        metric=known.units == "metres",
        side=side,
        outlines=outlines or {},
    )


def capture_choices(
    protocol: CaptureProtocol, num_frames: int, *, targets_per_scene: int = MAX_TARGETS
) -> list[FrameChoice]:
    """The frames of every sample of a capture.

    capture-2view: contexts i-1 and i+1, target i, for every i that has two neighbours.
    capture-8view: windows of 15 frames one after the other, as many as there are, in each the even
    ones as contexts and the 7 between as targets.

    Args:
        protocol: Which.
        num_frames: Of the capture.
        targets_per_scene: At most so many targets (capture-8view: rounded up to whole windows),
            spread evenly.

    Raises:
        ValueError: There are too few frames.
    """
    needed = FRAMES_NEEDED[protocol]
    if num_frames < needed:
        raise ValueError(f"it has {num_frames} frames, {protocol} needs {needed}")
    if protocol == "capture-2view":
        count = min(targets_per_scene, num_frames - 2)
        return frame_choices("rooms-2view", num_frames, targets_per_scene=count)
    windows = num_frames // needed
    count = min(-(-targets_per_scene // 7), windows)
    first = [needed * (k * windows // count) for k in range(count)]
    window = eight_view_protocol(needed)
    return [
        FrameChoice(
            tuple(start + k for k in window.context), tuple(start + k for k in window.target)
        )
        for start in first
    ]


def capture_scenes(
    captures: Sequence[Capture],
    protocol: CaptureProtocol,
    *,
    targets_per_scene: int = MAX_TARGETS,
    model_unit: Unit | None = None,
    strict: bool = False,
) -> Iterator[ProtocolScene]:
    """The captures one after the other, read when their turn comes.

    Those without metres, or for a model that answers in baselines, get the distance of the first
    two contexts as their unit. A capture or sample that cannot be used is left out with a warning
    that says why.

    Args:
        captures: From `read_capture`.
        protocol: Which.
        targets_per_scene: See `capture_choices`.
        model_unit: In which the model answers, if it learned one.
        strict: Raise what is wrong with a capture instead of leaving it out.

    Raises:
        ValueError: A capture cannot be used (strict), or targets_per_scene is below 1.
        FileNotFoundError: A file of a capture is not there (strict).
    """
    if targets_per_scene < 1:
        raise ValueError(f"targets_per_scene must be at least 1, got {targets_per_scene}")
    for capture in captures:
        unit: Unit = "metre" if capture.metric and model_unit != "baseline" else "baseline"
        samples = []
        try:
            choices = capture_choices(
                protocol, capture.num_frames(0), targets_per_scene=targets_per_scene
            )
            for choice in choices:
                try:
                    samples.append(make_sample(capture, 0, choice, unit=unit))
                except NoBaselineError as error:
                    warnings.warn(f"capture {capture.name}: {error}", stacklevel=2)
        except UNREADABLE as error:
            if strict:
                raise
            warnings.warn(f"capture {capture.name} is left out: {error}", stacklevel=2)
            continue
        if samples:
            yield ProtocolScene(capture.name, capture.name, tuple(samples), unit)
        else:
            warnings.warn(f"capture {capture.name} has no sample by {protocol}", stacklevel=2)
