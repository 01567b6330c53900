"""Small prepared scenes of made-up pixels, for tests of what reads prepared folders."""

from pathlib import Path

import numpy as np

from instok3d.datasets.prepared import PreparedFrame, SceneInfo, refresh_index, write_scene
from instok3d.datasets.prepared.format import Split


def made_frame(
    number: int, size: tuple[int, int] = (6, 8), layers: tuple[str, ...] = ("depths", "instances")
) -> PreparedFrame:
    rng = np.random.default_rng(number)
    pose = np.eye(4)
    pose[:3, 3] = 0.1 * number, 0.2, -0.3

    def ids(most: int) -> np.ndarray:
        return rng.integers(0, most, size).astype(np.uint16)

    return PreparedFrame(
        source=str(10 * number),
        image=rng.integers(0, 256, (*size, 3)).astype(np.uint8),
        world_from_cam=pose,
        intrinsics=np.array([[7.5, 0, size[1] / 2], [0, 7.5, size[0] / 2], [0, 0, 1]]),
        depth_thousandths=ids(5000) if "depths" in layers else None,
        instances=ids(4) if "instances" in layers else None,
        labels=ids(1400) if "labels" in layers else None,
    )


def made_folder(folder: Path, scenes: dict[str, Split], num_frames: int = 5) -> Path:
    """A prepared folder of these scenes and splits, with its index."""
    for name, split in scenes.items():
        info = SceneInfo(name, "scannet", split, "metre")
        write_scene(folder, info, [made_frame(number) for number in range(num_frames)])
    refresh_index(folder)
    return folder
