"""What the folders of --data hold: rendered rooms, or prepared scenes of the paper's data sets."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from instok3d.data.batches import Unit
from instok3d.datasets.prepared import PreparedScenes
from instok3d.datasets.prepared.index import INDEX as PREPARED_INDEX
from instok3d.datasets.prepared.index import read_index as read_prepared_index
from instok3d.evaluation.dataset_protocols import (
    DATASETS,
    ChooseFrames,
    DatasetProtocol,
    frame_chooser,
    protocol_scene,
    read_re10k_index,
    usable_choices,
)
from instok3d.evaluation.protocols import ProtocolScene
from instok3d.rooms.dataset import RoomDataset
from instok3d.rooms.seeding import split_seeds
from instok3d.rooms.shards import INDEX as ROOMS_INDEX
from instok3d.rooms.shards import read_index as read_rooms_index
from instok3d.tables.definitions import SceneKind, Views
from instok3d.tables.trainings import TablesOf, TrainingData

PROTOCOLS: dict[tuple[SceneKind, Views], DatasetProtocol] = {
    ("test", 2): "scannet-2view",
    ("test", 8): "scannet-8view",
    ("RealEstate10K", 2): "re10k-2view",
    ("MipNeRF360", 2): "mipnerf360-2view",
}
"""Of prepared scenes."""


def digest(names: Sequence[str]) -> str:
    """SHA-256 of a list of scenes, by their names in order."""
    return hashlib.sha256("\n".join(names).encode()).hexdigest()


def tables_of(folders: Sequence[Path]) -> TablesOf:
    """What the tables are made of, by what the folders hold.

    Raises:
        FileNotFoundError: A folder holds neither rooms nor prepared scenes.
        ValueError: Some hold rooms and some prepared scenes, one holds several data sets, or an
            index is damaged.
    """
    kinds = {folder: data_set_of(folder) for folder in folders}
    rooms = [folder for folder, kind in kinds.items() if kind == "rooms"]
    others = [folder for folder, kind in kinds.items() if kind != "rooms"]
    if rooms and others:
        raise ValueError(
            f"{rooms[0]} holds rooms and {others[0]} prepared scenes: tables are made of one or "
            "the other, name the folders of one kind in --data"
        )
    return "scannet" if others else "rooms"


def data_set_of(folder: Path) -> str:
    """The data set of a folder: 'rooms', or what its prepared scenes are of.

    Raises:
        FileNotFoundError: It holds neither rooms nor prepared scenes.
        ValueError: It holds scenes of several data sets, or its index is damaged.
    """
    if (folder / ROOMS_INDEX).is_file():
        return "rooms"
    if not (folder / PREPARED_INDEX).is_file():
        raise FileNotFoundError(
            f"{folder} holds no rooms ({ROOMS_INDEX}) and no prepared scenes ({PREPARED_INDEX}); "
            "tables are made of rooms (instok3d data rooms) or of ScanNet, RealEstate10K and "
            "MipNeRF360 (instok3d data prepare)"
        )
    found = sorted({entry["dataset"] for entry in read_prepared_index(folder).values()})
    if len(found) != 1:
        raise ValueError(
            f"{folder} holds scenes of {' and '.join(found) or 'no data set'}: tables take each "
            "data set from a folder of its own"
        )
    return found[0]


def training_folders(folders: Sequence[Path], of: TrainingData = "rooms") -> list[Path]:
    """Those that hold training scenes of a data set.

    Raises:
        FileNotFoundError: None does, or one holds no scenes at all.
        ValueError: See `data_set_of`.
    """
    found = [folder for folder in folders if data_set_of(folder) == of and _training_names(folder)]
    if not found:
        wanted = (
            "no room to train on in {}; make some with: instok3d data rooms -o DIR --seeds 0:2000, "
            "and name that folder in --data too"
            if of == "rooms"
            else f"no training scene of {of} in {{}}; prepare some with: instok3d data prepare "
            f"{of} --help, and name that folder in --data too"
        )
        raise FileNotFoundError(wanted.format(listed(folders)))
    return found


def training_digest(folders: Sequence[Path]) -> str:
    """SHA-256 of training scenes: of rooms their generator, size and seeds, else their records."""
    parts = []
    for folder in folders:
        if data_set_of(folder) == "rooms":
            index = read_rooms_index(folder)
            keys = ("generator_version", "resolution", "level")
            parts.append(repr({key: index[key] for key in keys}))
        parts += _training_names(folder)
    return digest(parts)


def _training_names(folder: Path) -> list[str]:
    """Seeds of rooms; names and hashes of the records of prepared scenes."""
    if data_set_of(folder) == "rooms":
        rooms = RoomDataset(folder, split_seeds("train"))
        return [rooms.name_of(number) for number in range(len(rooms))]
    index = read_prepared_index(folder)
    kept = [name for name in sorted(index) if index[name]["split"] == "train"]
    return [f"{name} {index[name]['sha256']}" for name in kept]


@dataclass(frozen=True)
class PreparedSet:
    """Test scenes of a prepared folder that a protocol of the papers can use."""

    scenes: PreparedScenes
    protocol: DatasetProtocol
    choose: ChooseFrames
    numbers: tuple[int, ...]

    @property
    def names(self) -> Sequence[str]:
        """Of their folders."""
        return [self.scenes.name_of(number) for number in self.numbers]

    def scene(self, number: int, views: Views, unit: Unit | None) -> ProtocolScene:
        """See `dataset_protocols.protocol_scene`; the protocol has its own number of views.

        Raises:
            ValueError: No sample of the scene can be measured: nothing is left out.
        """
        del views
        found = protocol_scene(
            self.scenes, self.numbers[number], self.protocol, self.choose, model_unit=unit
        )
        if found is None:
            name = self.scenes.name_of(self.numbers[number])
            raise ValueError(
                f"scene {name} of {self.scenes.folder} cannot be measured by {self.protocol}: "
                "its cameras stand at one place; take it out of the folder, then "
                "`instok3d data verify --index`"
            )
        return found


def prepared_set(
    folders: Sequence[Path],
    kind: SceneKind,
    views: Views,
    num_scenes: int | None,
    re10k_index: Path | None,
) -> PreparedSet:
    """The test scenes of a data set of the paper.

    Args:
        folders: Of prepared scenes.
        kind: Which data set; 'test' is ScanNet.
        views: Of the context.
        num_scenes: The first so many; None for all.
        re10k_index: The evaluation index of RealEstate10K, a JSON file.

    Raises:
        FileNotFoundError: There is no such scene, or no such index.
        ValueError: The protocol can use none of them.
    """
    protocol = PROTOCOLS[kind, views]
    for folder in folders:
        index = read_prepared_index(folder)
        if data_set_of(folder) in DATASETS[protocol] and any(
            entry["split"] == "test" for entry in index.values()
        ):
            break
    else:
        name = "ScanNet" if kind == "test" else kind
        raise FileNotFoundError(
            f"no test scene of {name} in {listed(folders)}; prepare them with: instok3d data "
            "prepare, and name that folder in --data too"
        )
    if protocol == "re10k-2view" and re10k_index is None:
        raise FileNotFoundError(
            "Table 5 on RealEstate10K asks for its evaluation index: give the file with --index "
            "evaluation_index_re10k.json"
        )
    entries = None if re10k_index is None else read_re10k_index(re10k_index)
    choose = frame_chooser(protocol, re10k_index=entries)
    scenes = PreparedScenes(folder, splits=("test",))
    numbers = tuple(_usable(scenes, choose, num_scenes))
    if not numbers:
        raise ValueError(f"{protocol} can use none of the {len(scenes)} test scenes of {folder}")
    return PreparedSet(scenes, protocol, choose, numbers)


def _usable(scenes: PreparedScenes, choose: ChooseFrames, num_scenes: int | None) -> Iterator[int]:
    left = num_scenes
    for number in range(len(scenes)):
        if left == 0:
            return
        if usable_choices(scenes, number, choose):
            left = None if left is None else left - 1
            yield number


def listed(folders: Sequence[Path]) -> str:
    """Their names, for messages."""
    return ", ".join(map(str, folders))
