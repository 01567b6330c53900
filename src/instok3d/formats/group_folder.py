"""A folder with one PLY for each group of a scene, such as the authors of the paper publish."""

from pathlib import Path

import torch

from instok3d.formats.ply import read_ply
from instok3d.formats.splats import Splats
from instok3d.types import Gaussians

MAX_FILES = 10_000


def read_group_folder(folder: Path) -> Splats:
    """The Gaussians of all PLYs in a folder; each file is a group, with its name as label.

    Groups are numbered from 1 in the order of the files' names. Groups within the files are not
    looked at. Colours of lower degree are filled up with zeros.

    Raises:
        ValueError: There is no PLY in the folder, or one of them is damaged.
    """
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".ply")
    if not files:
        raise ValueError(
            f"{folder} has no file that ends in .ply; wanted a folder with one for each group"
        )
    if len(files) > MAX_FILES:
        raise ValueError(f"{folder} has {len(files)} PLYs; at most {MAX_FILES} groups are read")
    parts = [read_ply(file) for file in files]
    most = max(part.gaussians.sh.shape[1] for part in parts)
    counts = torch.tensor([len(part.gaussians.means) for part in parts])
    stated = {part.up for part in parts}
    metric = all(part.units == "metres" for part in parts)
    return Splats(
        gaussians=Gaussians.concatenate([_with_bands(part.gaussians, most) for part in parts]),
        object_ids=torch.arange(1, len(parts) + 1).repeat_interleave(counts),
        labels={number: file.stem for number, file in enumerate(files, 1)},
        up=stated.pop() if len(stated) == 1 else None,
        units="metres" if metric else "arbitrary",
        notes=tuple(note for part in parts for note in part.notes),
    )


def _with_bands(gaussians: Gaussians, count: int) -> Gaussians:
    sh = gaussians.sh.new_zeros(len(gaussians.sh), count, 3)
    sh[:, : gaussians.sh.shape[1]] = gaussians.sh
    return Gaussians(**{**vars(gaussians), "sh": sh})
