"""Which evaluations `instok3d evaluate capture` consists of."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

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
from instok3d.evaluation.run import EvaluationSettings
from instok3d.model.files import read_card
from instok3d.scene.reconstruct import IMAGE_SIDE

ALIGNMENT_STEPS = 25
"""Steps in which target cameras are fitted to their photos for the second figures."""


@dataclass(frozen=True)
class Run:
    """One evaluation of a command."""

    protocol: str
    settings: EvaluationSettings
    total: int
    """Scenes to look at."""
    scenes: Iterable[ProtocolScene]

    @property
    def name(self) -> str:
        """Of its pictures."""
        fitted = self.settings.pose_alignment_steps and self.protocol.startswith("capture-")
        return f"{self.protocol}_aligned" if fitted else self.protocol


def capture_runs(
    data: Path,
    protocol: Literal["capture", CaptureProtocol],
    settings: EvaluationSettings,
    *,
    steps: int,
    num_captures: int | None,
    model: Path | None,
    targets_per_scene: int | None,
    frame_step: int,
    outlines: Path | None,
) -> list[Run]:
    """Each protocol with the targets where the predicted cameras place them, then aligned.

    Args:
        data: A capture or a folder of captures.
        protocol: One, or capture for both.
        settings: Of the first kind.
        steps: Of the alignment; 0 leaves the second kind out.
        num_captures: Only the first so many; None for all.
        model: Its card says how large frames are.
        targets_per_scene: See `captures.capture_choices`; None for as many as a rule.
        frame_step: See `captures.read_capture`.
        outlines: A folder; None takes those of the package.

    Raises:
        FileNotFoundError: There is no capture or no outlines.
        ValueError: No capture can be used, or a number is out of its range.
    """
    most = MAX_TARGETS if targets_per_scene is None else targets_per_scene
    for name, value in (("--scenes", num_captures), ("--targets-per-scene", most),
                        ("--frame-step", frame_step)):  # fmt: skip
        if value is not None and value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")
    side = int(read_card(model).get("image_side", IMAGE_SIDE))
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
        for each in (0, steps) if steps else (0,):
            found = capture_scenes(
                usable, name, targets_per_scene=most, model_unit=settings.model_unit
            )
            again = {"pose_alignment_steps": each, "baselines": settings.baselines and not each}
            if usable:
                runs.append(Run(name, replace(settings, **again), len(usable), found))
    if not runs:
        raise ValueError(f"no capture in {data} can be measured by {protocol}: see the warnings")
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
