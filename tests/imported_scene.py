"""An imported scene made by hand: three clusters of Gaussians, and some that belong to none."""

import torch

from instok3d.scene.from_gaussians import scene_from_gaussians
from instok3d.scene.record import Provenance
from instok3d.scene.scene import Scene
from instok3d.types import Gaussians

IMPORTED = Provenance("instok3d 0", "imported", "", seed=0)


def made_gaussians(count: int, sh_count: int = 4, seed: int = 0) -> Gaussians:
    """Gaussians about the origin, within 1 of it."""
    generator = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=2 * torch.rand(count, 3, generator=generator) - 1,
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1),
        scales=0.05 + 0.1 * torch.rand(count, 3, generator=generator),
        opacities=0.3 + 0.6 * torch.rand(count, generator=generator),
        sh=0.5 * torch.randn(count, sh_count, 3, generator=generator),
        anchor_index=torch.zeros(count, dtype=torch.long),
    )


def imported_scene(ids: tuple[int, ...] = (7, 0, 2, 5), each: int = 10, **options) -> Scene:
    """`each` Gaussians of every id, the clusters 3 apart along x, in a shuffled order."""
    object_ids = torch.tensor(ids, dtype=torch.long).repeat_interleave(each)
    gaussians = made_gaussians(len(object_ids))
    gaussians.means[:, 0] += 3 * torch.arange(len(ids)).repeat_interleave(each)
    order = torch.randperm(len(object_ids), generator=torch.Generator().manual_seed(1))
    return scene_from_gaussians(
        gaussians.rows(order), object_ids[order], provenance=IMPORTED, height=24, width=32,
        **options,
    )  # fmt: skip
