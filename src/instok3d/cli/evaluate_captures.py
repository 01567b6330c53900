"""Which evaluations `instok3d evaluate capture` consists of."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from instok3d.data.batches import Unit
from instok3d.evaluation.captures import (
    FRAMES_NEEDED,
    MAX_TARGETS,
    UNREADABLE,
    Capture,
    CaptureProtocol,
    capture_scenes,
    find_captures,
    read_capture,
)
from instok3d.evaluation.outlines import OWN_OUTLINES, read_outlines
from instok3d.evaluation.protocols import ProtocolScene
from instok3d.model.files import read_card
from instok3d.scene.reconstruct import IMAGE_SIDE

ALIGNMENT_STEPS = 25
"""Steps in which target cameras are fitted to their photos for the second figures."""


@dataclass(frozen=True)
class Run:
    """One evaluation of a command."""

    protocol: str
    total: int
    """Scenes to look at."""
    scenes: Iterable[ProtocolScene]


def capture_runs(
    data: Path,
    protocol: Literal["capture", CaptureProtocol],
    *,
    model: Path | None,
    num_captures: int | None,
    targets_per_scene: int | None,
    frame_step: int,
    frame_pixels: int | None,
    outlines: Path | None,
    unit: Unit | None,
) -> list[Run]:
    """The captures by one protocol, or by both; none where no capture has enough frames.

    Args:
        data: A capture or a folder of captures.
        protocol: One, or capture for both.
        model: Its card says how large frames are, if `frame_pixels` does not.
        num_captures: Only the first so many; None for all.
        targets_per_scene: See `captures.capture_choices`; None for as many as a rule.
        frame_step: See `captures.read_capture`.
        frame_pixels: Height of the frames.
        outlines: A folder; None takes those of the package.
        unit: In which the model answers, if it learned one.

    Raises:
        FileNotFoundError: There is no capture or no outlines.
        ValueError: The only capture cannot be used, or a number is out of its range.
    """
    most = MAX_TARGETS if targets_per_scene is None else targets_per_scene
    for name, value in (("--scenes", num_captures), ("--targets-per-scene", most),
                        ("--frame-step", frame_step)):  # fmt: skip
        if value is not None and value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")
    side = frame_pixels or int(read_card(model).get("image_side", IMAGE_SIDE))
    known = read_outlines(OWN_OUTLINES if outlines is None else outlines)
    captures = []
    folders = find_captures(data)[:num_captures]
    for folder in folders:
        try:
            captures.append(read_capture(folder, side=side, outlines=known, frame_step=frame_step))
        except UNREADABLE as error:
            if len(folders) == 1:
                raise
            warnings.warn(f"capture {folder.name} is left out: {error}", stacklevel=2)
    asked: Sequence[CaptureProtocol] = list(FRAMES_NEEDED) if protocol == "capture" else [protocol]
    runs = []
    for name in asked:
        usable = _long_enough(captures, name)
        if usable:
            found = capture_scenes(
                usable, name, targets_per_scene=most, model_unit=unit, strict=len(folders) == 1
            )
            runs.append(Run(name, len(usable), found))
    return runs


def _long_enough(captures: Sequence[Capture], protocol: CaptureProtocol) -> list[Capture]:
    needed = FRAMES_NEEDED[protocol]
    short = [each.name for each in captures if each.num_frames(0) < needed]
    if short:
        warnings.warn(
            f"{len(short)} of {len(captures)} captures have fewer than the {needed} frames that "
            f"{protocol} needs and are left out: {', '.join(short)}",
            stacklevel=3,
        )
    return [each for each in captures if each.name not in short]
