"""Which data set a folder holds, by the index that lies in it."""

from collections.abc import Sequence
from pathlib import Path

from instok3d.data.broken_tracks import BROKEN_TRACKS, BrokenTracks
from instok3d.data.joined import JoinedScenes
from instok3d.data.scenes import SceneSource
from instok3d.datasets.prepared import PreparedScenes
from instok3d.datasets.prepared.index import INDEX as PREPARED_INDEX
from instok3d.rooms import RoomDataset
from instok3d.rooms.seeding import split_seeds
from instok3d.rooms.shards import INDEX as ROOMS_INDEX


def open_training_scenes(folders: Sequence[Path], *, masks: str | None = None) -> SceneSource:
    """The scenes of the training split of folders of rooms or of prepared scenes, in turn.

    Args:
        folders: From `instok3d data rooms` or `instok3d data prepare`; at least one.
        masks: Take the ids that this model made instead of the true ones (prepared scenes); of
            rooms, BROKEN_TRACKS alone, which are true ids made worse.

    Raises:
        FileNotFoundError: A folder holds neither, or lacks such masks.
        ValueError: Masks were asked of rooms, an index is damaged, two scenes have one name, or
            no folder.
    """
    sources = [_open(folder, masks) for folder in folders]
    return sources[0] if len(sources) == 1 else JoinedScenes(sources)


def _open(folder: Path, masks: str | None) -> SceneSource:
    if (folder / ROOMS_INDEX).is_file():
        rooms = RoomDataset(folder, split_seeds("train"))
        if masks is None:
            return rooms
        if masks == BROKEN_TRACKS:
            return BrokenTracks(rooms)
        raise ValueError(
            f"{folder} holds rooms, which have true ids: leave masks {masks} out, or take "
            f"{BROKEN_TRACKS} for ids that break as those of a tracker"
        )
    if (folder / PREPARED_INDEX).is_file():
        return PreparedScenes(folder, masks=masks)
    raise FileNotFoundError(
        f"{folder} holds neither rooms ({ROOMS_INDEX}) nor prepared scenes ({PREPARED_INDEX}); "
        "make them with `instok3d data rooms` or `instok3d data prepare`"
    )
