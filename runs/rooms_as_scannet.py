"""Rendered rooms as files of ScanNet's formats: .sens scans, id archives, the label table.

    python runs/rooms_as_scannet.py ROOMS -o FOLDER --test 2

The last of them take names of ScanNet's last 50 scans, from which its test scenes are chosen; the
others become training scans (scene0000_00, scene0001_00, ...). The 16 frames of a room stand about
as far apart as every tenth frame of ScanNet, so the scans have these alone: prepare them with
`--stride 1 --min-frames 1`.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from instok3d.datasets.scannet.id_maps import Kind, write_id_maps
from instok3d.datasets.scannet.labels import TABLE
from instok3d.datasets.scannet.sens import RecordedFrame, write_sens
from instok3d.datasets.scannet.splits import TEST_POOL
from instok3d.files import replacing, write_json
from instok3d.rooms import RoomDataset
from instok3d.rooms.classes import CLASSES, NYU40
from instok3d.rooms.dataset import RoomScene

RAW_LABELS = {name: number for number, name in enumerate(CLASSES, 1)}
"""The rooms' classes, where ScanNet has some 600 of its own."""


def write_scan(folder: Path, name: str, room: RoomScene) -> None:
    """One room as a scan: SCAN.sens, its two archives and its aggregation."""
    scan = folder / "scans" / name
    scan.mkdir(parents=True, exist_ok=True)
    images, depths = room.images.numpy(), (room.depths_m * 1000).round().numpy().astype(np.uint16)
    ids = room.instances.numpy()
    frames = [
        RecordedFrame(image, depth, pose.astype(np.float64))
        for image, depth, pose in zip(images, depths, room.world_from_cam.numpy(), strict=True)
    ]
    write_sens(scan / f"{name}.sens", frames, room.intrinsics[0].double().numpy())
    instances: list[dict[str, Any]] = room.meta["instances"]
    label_of = np.zeros(int(ids.max()) + 1, dtype=np.int64)
    for each in instances:
        label_of[each["id"]] = RAW_LABELS[each["class"]]
    archives: list[tuple[Kind, np.ndarray]] = [
        ("instance-filt", ids), ("label-filt", label_of[ids])
    ]  # fmt: skip
    for kind, maps in archives:
        path = scan / f"{name}_2d-{kind}.zip"
        write_id_maps(path, kind, dict(enumerate(maps)))
    groups = [{"id": each["id"] - 1, "label": each["class"], "segments": []} for each in instances]
    write_json(scan / f"{name}.aggregation.json", {"sceneId": name, "segGroups": groups})


def write_table(folder: Path) -> None:
    """The label table of the rooms' classes."""
    rows = [f"{k}\t{n}\t{NYU40.get(n, 'otherfurniture')}" for n, k in RAW_LABELS.items()]
    with replacing(folder / TABLE) as part:
        part.write_text("\n".join(["id\traw_category\tnyu40class", *rows]) + "\n")


def main() -> None:
    """Write the first rooms of a folder, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rooms", type=Path, help="from instok3d data rooms")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--test", type=int, default=2, help="how many become test scans")
    parser.add_argument("--training", type=int, help="how many become training scans; the others")
    arguments = parser.parse_args()
    rooms = RoomDataset(arguments.rooms)
    others = len(rooms) - arguments.test
    training = others if arguments.training is None else arguments.training
    if not 1 <= training <= others:
        raise SystemExit(f"{arguments.rooms} has {len(rooms)} rooms, too few for training and test")
    for number in range(training + arguments.test):
        name = f"scene{number:04d}_00" if number < training else TEST_POOL[number - training]
        write_scan(arguments.output, name, rooms.scene(number))
    write_table(arguments.output)
    print(json.dumps({"training": training, "test": arguments.test}))


if __name__ == "__main__":
    main()
