"""Prepared folders: real data sets of every origin as small pictures, cameras and checksums.

One folder for each scene with scene.json, images/ and, where they are known, depths/, instances/
and labels/; the index scenes.json beside the scenes only repeats what they say.
"""

from instok3d.datasets.prepared.format import (
    Dataset,
    DroppedFrame,
    PreparedFrame,
    SceneInfo,
    SceneRecord,
    Split,
    Unit,
    read_scene,
)
from instok3d.datasets.prepared.index import read_index, refresh_index, scene_folders
from instok3d.datasets.prepared.scenes import PreparedScenes
from instok3d.datasets.prepared.verifying import Fault, verify
from instok3d.datasets.prepared.writing import write_scene

__all__ = [
    "Dataset",
    "DroppedFrame",
    "Fault",
    "PreparedFrame",
    "PreparedScenes",
    "SceneInfo",
    "SceneRecord",
    "Split",
    "Unit",
    "read_index",
    "read_scene",
    "refresh_index",
    "scene_folders",
    "verify",
    "write_scene",
]
