"""Which object each pixel of the input views shows: 16-bit PNGs and COCO's instances."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool
from PIL import Image

from instok3d.files import json_text, replacing_folder
from instok3d.formats.layouts import check_views
from instok3d.formats.statements import scene_comments
from instok3d.scene.run_lengths import RunLengths
from instok3d.scene.scene import Scene

INSTANCES = "instances.json"
LARGEST_ID = 2**16 - 1
UNNAMED = "object"
"""Category of objects without a label."""


def write_masks(folder: Path, scene: Scene, *, overwrite: bool = False) -> None:
    """Write NNN_ids.png for each input view at the scene's size, and instances.json, or nothing.

    Pixels hold the object's id, 0 where no object is. Masks in instances.json are uncompressed
    run lengths; `instance_id` is the object's id, the same in all views.

    Raises:
        FileExistsError: Something is there, and overwrite is off or it holds no masks.
        ValueError: The scene has no views, or an id does not fit into 16 bits.
    """
    check_views(scene, "a set of masks")
    if any(item.id > LARGEST_ID for item in scene.objects):
        raise ValueError(f"{folder}: ids above {LARGEST_ID} do not fit into 16-bit pictures")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / INSTANCES).is_file():
        raise FileExistsError(f"{folder} holds other things than exported masks")
    names = sorted({item.label or UNNAMED for item in scene.objects})
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    with replacing_folder(folder, overwrite=overwrite) as part:
        for index, view in enumerate(scene.views):
            seen = scene.render([index], ids=True).ids
            assert seen is not None
            ids, name = seen[0].numpy(), f"{index:03d}_ids.png"
            Image.fromarray(ids.astype(np.uint16)).save(part / name)
            images.append({"id": index + 1, "file_name": view.file, "ids_file": name,
                           "height": scene.height, "width": scene.width})  # fmt: skip
            for item in scene.objects:
                mask = ids == item.id
                if mask.any():
                    annotations.append({
                        "id": len(annotations) + 1,
                        "image_id": index + 1,
                        "category_id": names.index(item.label or UNNAMED) + 1,
                        "instance_id": item.id,
                        "key": item.key,
                        "score": item.confidence,
                        "iscrowd": 0,
                        **coco_mask(mask),
                    })  # fmt: skip
        value = {
            "info": {"description": list(scene_comments(scene))},
            "images": images,
            "categories": [{"id": i, "name": name} for i, name in enumerate(names, 1)],
            "annotations": annotations,
        }
        (part / INSTANCES).write_text(json_text(value) + "\n", encoding="utf-8")


def coco_mask(mask: Bool[np.ndarray, "height width"]) -> dict[str, Any]:
    """COCO's segmentation, bbox (x, y, width, height) and area of a mask with a pixel at least."""
    y, x = np.nonzero(mask)
    left, top = int(x.min()), int(y.min())
    return {
        "segmentation": RunLengths.of(torch.from_numpy(mask)).to_json(),
        "bbox": [left, top, int(x.max()) + 1 - left, int(y.max()) + 1 - top],
        "area": int(mask.sum()),
    }
