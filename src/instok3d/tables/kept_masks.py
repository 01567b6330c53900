"""Id maps of context views in files: methods that are given the same masks make them once."""

import hashlib
from pathlib import Path

from jaxtyping import Int
from safetensors.torch import load_file
from torch import Tensor

from instok3d.baselines.context_masks import MasksOf
from instok3d.data.sample import Sample
from instok3d.files import write_safetensors
from instok3d.reading import naming_damage

REMEDY = "remove it, the masks are then made again"


def kept_masks(masks_of: MasksOf, folder: Path) -> MasksOf:
    """The same id maps, read from a file where they were made before.

    A file is known by the name, the photos and the true ids of the context views. What is returned
    raises ValueError for a damaged file.

    Args:
        masks_of: Makes the id maps of the context views of a sample of one.
        folder: For the files of this way to make them and no other; made if it is not there.
    """

    def kept(sample: Sample) -> Int[Tensor, "view height width"]:
        path = folder / f"{_key(sample)}.safetensors"
        if not path.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            write_safetensors(path, {"ids": masks_of(sample).contiguous()})
        with naming_damage(path, REMEDY):
            return load_file(path)["ids"]

    return kept


def _key(sample: Sample) -> str:
    found = hashlib.sha256(sample.names[0].encode())
    for tensor in (sample.context.images, sample.context_instances):
        found.update(f" {tensor.dtype} {tuple(tensor.shape)} ".encode())
        found.update(tensor.contiguous().numpy().tobytes())
    return found.hexdigest()[:16]
