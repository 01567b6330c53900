"""Writing one scene of a prepared folder, whole or not at all."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from instok3d.datasets.prepared.format import (
    FORMAT,
    RECORD,
    DroppedFrame,
    PreparedFrame,
    SceneInfo,
    SceneRecord,
    check_camera,
    read_scene,
)
from instok3d.files import replacing_folder, sha256_of, write_json


def write_scene(
    folder: Path, info: SceneInfo, frames: Iterable[PreparedFrame | DroppedFrame]
) -> SceneRecord:
    """Write one scene below `folder`; it appears whole, or after any error not at all.

    Args:
        folder: The prepared folder; made if it is not there. Its index is not touched.
        info: Name and kind of the scene.
        frames: In order; they are numbered from 0. Taken one by one, so they may be made lazily.

    Returns:
        What now stands in its scene.json.

    Raises:
        FileExistsError: The scene is there already.
        ValueError: No frame is left, frames differ in size or in what they have, or a camera
            cannot be.
    """
    target = folder / info.name
    if target.exists():
        raise FileExistsError(f"{target} is already there; delete it to prepare the scene again")
    folder.mkdir(parents=True, exist_ok=True)
    with replacing_folder(target, overwrite=False) as part:
        rows: list[dict[str, Any]] = []
        files: dict[str, list[int | str]] = {}
        dropped: Counter[str] = Counter()
        kind: tuple[Any, ...] | None = None
        for frame in frames:
            if isinstance(frame, DroppedFrame):
                dropped[frame.reason] += 1
                continue
            layers = _checked_layers(frame, kind, info.name)
            kind = _kind(frame, layers)
            for layer, pixels in layers.items():
                files[f"{layer}/{len(rows):06d}.png"] = _write_png(part, layer, len(rows), pixels)
            rows.append(
                {
                    "source": frame.source,
                    "world_from_cam": _rows(frame.world_from_cam),
                    "intrinsics": _rows(frame.intrinsics),
                }
            )
        if kind is None:
            raise ValueError(f"scene {info.name} has no usable frame{_counted(dropped)}")
        size = {"height": kind[0], "width": kind[1]}
        write_json(
            part / RECORD,
            {"format": FORMAT, **asdict(info), **size, "frames": rows,
             "dropped": dict(sorted(dropped.items())), "files": files},
        )  # fmt: skip
    return read_scene(target)


def _checked_layers(
    frame: PreparedFrame, kind: tuple[Any, ...] | None, scene: str
) -> dict[str, np.ndarray]:
    """The pictures of a frame by the folder that they go to."""
    layers = {"images": frame.image}
    optional = {
        "depths": frame.depth_thousandths, "instances": frame.instances, "labels": frame.labels
    }  # fmt: skip
    layers |= {name: pixels for name, pixels in optional.items() if pixels is not None}
    found = _kind(frame, layers)
    if kind is not None and found != kind:
        raise ValueError(
            f"frame {frame.source} of scene {scene} has {found}, the frames before it {kind}; all "
            "frames of a scene must agree in height, width and kinds of pictures"
        )
    for name, pixels in layers.items():
        if pixels.shape[:2] != frame.image.shape[:2]:
            raise ValueError(
                f"frame {frame.source} of scene {scene}: its {name} have the size "
                f"{pixels.shape[:2]}, its image {frame.image.shape[:2]}"
            )
    if frame.world_from_cam is not None or frame.intrinsics is not None:
        check_camera(
            _rows(frame.world_from_cam), _rows(frame.intrinsics),
            where=f"frame {frame.source} of scene {scene}",
            height=frame.image.shape[0], width=frame.image.shape[1],
        )  # fmt: skip
    return layers


def _kind(frame: PreparedFrame, layers: dict[str, np.ndarray]) -> tuple[Any, ...]:
    posed = frame.world_from_cam is not None and frame.intrinsics is not None
    return (*frame.image.shape[:2], *layers, "cameras" if posed else "no cameras")


def _rows(matrix: np.ndarray | None) -> list[list[float]] | None:
    return None if matrix is None else matrix.tolist()


def _write_png(part: Path, layer: str, number: int, pixels: np.ndarray) -> list[int | str]:
    path = part / layer / f"{number:06d}.png"
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(pixels).save(path, "PNG", compress_level=3)  # 6: 3 x the time, 5 % smaller
    return [path.stat().st_size, sha256_of(path)]


def _counted(dropped: Counter[str]) -> str:
    counts = ", ".join(f"{count} with {reason}" for reason, count in sorted(dropped.items()))
    return f" (dropped: {counts})" if counts else ""
