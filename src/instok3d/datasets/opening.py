"""Which data set a folder holds, by the index that lies in it."""

from pathlib import Path

from instok3d.data.scenes import SceneSource
from instok3d.datasets.prepared import PreparedScenes
from instok3d.datasets.prepared.index import INDEX as PREPARED_INDEX
from instok3d.rooms import RoomDataset
from instok3d.rooms.seeding import split_seeds
from instok3d.rooms.shards import INDEX as ROOMS_INDEX


def open_training_scenes(folder: Path, *, masks: str | None = None) -> SceneSource:
    """The scenes of the training split of a folder of rooms or of prepared scenes.

    Args:
        folder: From `instok3d data rooms` or `instok3d data prepare`.
        masks: Take the ids that this model made instead of the true ones (prepared scenes).

    Raises:
        FileNotFoundError: The folder holds neither, or lacks such masks.
        ValueError: Masks were asked of rooms, or the index is damaged.
    """
    if (folder / ROOMS_INDEX).is_file():
        if masks is not None:
            raise ValueError(f"{folder} holds rooms, which have true ids: leave masks {masks} out")
        return RoomDataset(folder, split_seeds("train"))
    if (folder / PREPARED_INDEX).is_file():
        return PreparedScenes(folder, masks=masks)
    raise FileNotFoundError(
        f"{folder} holds neither rooms ({ROOMS_INDEX}) nor prepared scenes ({PREPARED_INDEX}); "
        "make them with `instok3d data rooms` or `instok3d data prepare`"
    )
