"""What one call of the command works with, and where it keeps what it has made."""

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from instok3d.evaluation.protocols import ProtocolScene
from instok3d.model.files import DEFAULT_MODEL, read_card
from instok3d.objectives.lpips import Lpips
from instok3d.rooms.shards import read_index
from instok3d.scene.reconstruct import IMAGE_SIDE
from instok3d.tables.data_sets import (
    prepared_set,
    training_digest,
    training_folders,
)
from instok3d.tables.definitions import SceneKind, Views
from instok3d.tables.digests import digest_of
from instok3d.tables.scene_sets import (
    TARGETS_PER_SCENE,
    SceneSet,
    captures,
    rooms_to_test,
    transfer_rooms,
)
from instok3d.tables.trainings import Schedule, TrainingData, data_of

QUICK_SCENES, QUICK_TARGETS = 2, 1
PICTURED = 3
"""The first so many scenes are shown in the figures."""


@dataclass(frozen=True)
class Work:
    """The folder of the tables, and what they are made of."""

    folder: Path
    data: tuple[Path, ...]
    """Folders of rooms, or of prepared scenes (`data_sets`)."""
    schedule: Schedule
    num_scenes: int | None = None
    """The first so many of each set; None for all."""
    captures: Path | None = None
    backbone: Path = DEFAULT_MODEL
    """A run or file whose backbone all trainings begin with."""
    model: Path | None = None
    """That is OURS; None trains it."""
    semantics: Path | None = None
    """Of that model; None trains them."""
    segmenter: Path | None = None
    """Whose masks methods are given; None trains it."""
    method_steps: int | None = None
    """Of methods that optimise each scene; None takes their own."""
    lpips: Lpips | None = None
    command: str = ""
    """That is written into the cells."""
    re10k_index: Path | None = None
    """The evaluation index of RealEstate10K."""
    digests: dict[TrainingData, str] = field(default_factory=dict, repr=False)
    """Of training scenes, those that were asked for."""
    sets: dict[tuple[SceneKind, Views], SceneSet] = field(default_factory=dict, repr=False)
    """Those that were opened."""

    def training_folders(self, name: str) -> list[Path]:
        """Folders with the scenes that a training sees."""
        return training_folders(self.data, data_of(name, self.schedule))

    def training_digest(self, name: str) -> str:
        """Of the scenes to train on that are there as the command begins."""
        data = data_of(name, self.schedule)
        if data not in self.digests:
            self.digests[data] = training_digest(training_folders(self.data, data))
        return self.digests[data]

    @cached_property
    def backbone_digest(self) -> str:
        """SHA-256 of the file with the backbone, which is the newest checkpoint of a run.

        Raises:
            FileNotFoundError: There is neither.
        """
        if self.backbone.is_file():
            return digest_of(self.backbone)
        checkpoints = sorted((self.backbone / "checkpoints").glob("step_*.pt"))
        if not checkpoints:
            raise FileNotFoundError(f"no run folder and no .safetensors file at {self.backbone}")
        return digest_of(checkpoints[-1])

    @property
    def _targets(self) -> int:
        return QUICK_TARGETS if self.schedule.quick else TARGETS_PER_SCENE

    @property
    def limit(self) -> int | None:
        """Of scenes of each set."""
        return QUICK_SCENES if self.schedule.quick and self.num_scenes is None else self.num_scenes

    def scenes(self, kind: SceneKind, views: Views) -> SceneSet:
        """A set of scenes, opened once.

        Raises:
            FileNotFoundError: It is not there; says what makes it.
            ValueError: It cannot be used.
        """
        if (kind, views) not in self.sets:
            self.sets[kind, views] = self._opened(kind, views)
        return self.sets[kind, views]

    def _opened(self, kind: SceneKind, views: Views) -> SceneSet:
        if self.schedule.of == "scannet":
            return prepared_set(self.data, kind, views, self.limit, self.re10k_index)
        if kind == "test":
            return rooms_to_test(self.data, self.limit, self._targets)
        if kind != "captures":
            return transfer_rooms(self.data, kind, self.limit, self._targets)
        if self.captures is None:
            raise FileNotFoundError(
                "Table 6 asks for captures of real rooms: give a folder of them with --captures DIR"
            )
        if self.model is None:
            side = read_index(training_folders(self.data)[0])["resolution"]
        else:
            side = int(read_card(self.model).get("image_side", IMAGE_SIDE))
        return captures(self.captures, side, views, self._targets)

    def scene(self, kind: SceneKind, views: Views, number: int, unit: Any) -> ProtocolScene:
        """One scene of a set."""
        return self.scenes(kind, views).scene(number, views, unit)


def key_of(**about: Any) -> str:
    """Twelve digits of the SHA-256 of what something was made from."""
    text = json.dumps(about, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
