"""Scenes from files of Gaussians, and ids for Gaussians that were edited elsewhere."""

from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from instok3d.files import sha256_of
from instok3d.formats.registry import read_splats
from instok3d.formats.splats import Splats
from instok3d.scene.from_gaussians import UNKNOWN_UP, scene_from_gaussians
from instok3d.scene.names import check_label
from instok3d.scene.record import Provenance
from instok3d.scene.scene import Scene
from instok3d.scene.vertical import Vertical
from instok3d.types import Gaussians
from instok3d.version import generator

STATED_CONFIDENCE = 0.9
"""Of an up direction that a file states."""
SAME = 1e-3
"""Largest difference of two Gaussians that are taken for one, in log scales, opacity and colour;
programs that edit keep them to single precision."""
SAME_SHARE = 0.5
"""Share of a file's Gaussians that must be found in the scene that they are matched with."""


def import_scene(path: Path, *, match: Scene | None = None) -> Scene:
    """The scene of a file of Gaussians, or of a folder with one PLY for each group.

    Args:
        path: Any file that `registry.read_splats` reads.
        match: A scene that the file was exported from before another program edited it: Gaussians
            of the file get the objects of its Gaussians, see `matched_ids`.

    Raises:
        FileNotFoundError: Nothing of this name is there.
        ValueError: It is damaged, holds no Gaussians, or does not come from the matching scene.
    """
    splats = read_splats(path)
    notes = [note.replace(str(path), path.name) for note in splats.notes]
    if not len(splats.gaussians.means):
        raise ValueError(f"{path} holds no Gaussians that can be drawn")
    if match is not None:
        ids = matched_ids(splats, match, path)
        names = {item.id: item.label for item in match.objects}
        splats = replace(
            splats, object_ids=ids, labels={i: name for i, name in names.items() if name}
        )
        lost = len(match.objects) - len(set(ids[ids > 0].tolist()))
        notes += [f"{lost} objects of the matching scene are not in {path.name}"] if lost else []
    labels = {number: name for number, name in splats.labels.items() if _is_label(name)}
    if len(labels) < len(splats.labels):
        notes.append(f"{len(splats.labels) - len(labels)} names of objects cannot be used")
    vertical = UNKNOWN_UP
    if splats.up is not None:
        vertical = Vertical(splats.up, "file", STATED_CONFIDENCE)
    made_by = Provenance(
        generator=generator(),
        model=f"imported from {path.name}",
        model_sha256="" if path.is_dir() else sha256_of(path),
        seed=0,
    )
    return scene_from_gaussians(
        splats.gaussians, splats.object_ids, provenance=made_by, labels=labels,
        units=splats.units, vertical=vertical, notes=notes,
    )  # fmt: skip


def _is_label(name: str) -> bool:
    try:
        check_label(name)
    except ValueError:
        return False
    return True


def matched_ids(splats: Splats, scene: Scene, path: Path) -> Int[Tensor, " gaussian"]:
    """The scene's object of each Gaussian of a file that was edited elsewhere, 0 where none fits.

    Programs that edit remove, move and turn Gaussians but keep opacity and constant colour, and
    the ratios of their scales, in order. Those tell the Gaussians apart; among equal ones the
    nearest is taken.

    Raises:
        ValueError: Less than half of the file's Gaussians are in the scene.
    """
    mine, theirs = _signature(scene.gaussians), _signature(splats.gaussians)
    distances, rows = KDTree(mine.numpy()).query(theirs.numpy(), p=torch.inf)
    found = torch.from_numpy(distances) <= SAME
    if not found.float().mean() >= SAME_SHARE:
        raise ValueError(
            f"only {int(found.sum())} of {len(found)} Gaussians of {path} are in the scene to be "
            "matched; give the scene that it was exported from, and a format that keeps Gaussians "
            "exact, such as .ply"
        )
    ids = scene.object_ids()[torch.from_numpy(rows)]
    return torch.where(found, ids, 0)


def _signature(gaussians: Gaussians) -> Float[Tensor, "gaussian 6"]:
    """Opacity, ratios of scales and constant colour: what motion and uniform scaling leave."""
    scales = gaussians.scales.detach().cpu().double().log()
    ratios = scales - scales.mean(dim=1, keepdim=True)
    opacities = gaussians.opacities.detach().cpu().double()
    colors = gaussians.sh[:, 0].detach().cpu().double()
    return torch.cat([opacities[:, None], ratios[:, :2], colors], dim=1)
