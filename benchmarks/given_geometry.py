"""What wrong cameras and depth cost a model that takes them as given.

True cameras and depth of test rooms, made worse in the ways of depth networks, are given to the
model, as `reconstruct --geometry` gives it those of another backbone. Targets are rendered at their
cameras brought into the world of the given ones, as for a model that sees photos alone.

    python benchmarks/given_geometry.py --data rooms-test
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.evaluation.protocols import ProtocolName, ProtocolScene, protocol_rooms
from instok3d.evaluation.run import EvaluationSettings, evaluate
from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.rotations import quat_to_matrix
from instok3d.model.files import load_model
from instok3d.rooms import RoomDataset
from instok3d.types import TokenGroups, Views

Damage = Callable[[Views, torch.Generator], Views]


@dataclass(frozen=True)
class Options:
    """What to measure."""

    data: Path
    """Folder of the test rooms."""
    protocol: ProtocolName = "rooms-2view"
    rooms: int = 20
    """The first so many of the folder."""
    model: Path | None = None
    """A model file; None takes the default model."""
    refine: int = 0
    """Steps of refinement on the photos."""
    seed: int = 0
    """Of the damage."""
    threads: int = 1


def drift(share: float) -> Damage:
    """Depth of each view times its own factor, plus its own shift, both of this deviation."""

    def damaged(views: Views, random: torch.Generator) -> Views:
        depths = _depths(views)
        factor, shift = (
            share * torch.randn(2, 1, depths.shape[1], 1, 1, generator=random)
        ).unbind()
        moved = depths * factor.exp() + shift * depths.median()
        return replace(views, depths=torch.where(depths > 0, moved.clamp_min(0.05), 0))

    return damaged


def smooth(sigma_px: float) -> Damage:
    """Depth blurred by a Gaussian, which puts points between objects and what lies behind them."""

    def damaged(views: Views, random: torch.Generator) -> Views:
        reach = math.ceil(3 * sigma_px)
        kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / sigma_px) ** 2)
        kernel = kernel / kernel.sum()
        depths = _depths(views)[0, :, None]
        padded = functional.pad(depths, (reach, reach, reach, reach), mode="replicate")
        across = functional.conv2d(padded, kernel.view(1, 1, 1, -1))
        return replace(
            views, depths=functional.conv2d(across, kernel.view(1, 1, -1, 1))[None, :, 0]
        )

    return damaged


def noise(share: float, grain_px: int = 8) -> Damage:
    """Depth times a factor that varies from place to place with this deviation."""

    def damaged(views: Views, random: torch.Generator) -> Views:
        depths = _depths(views)
        height, width = depths.shape[-2:]
        coarse = torch.randn(
            1, depths.shape[1], height // grain_px, width // grain_px, generator=random
        )
        field = functional.interpolate(coarse, size=(height, width), mode="bicubic")
        return replace(views, depths=depths * (share * field / field.std()).exp())

    return damaged


def turn(angle_deg: float) -> Damage:
    """Each camera but the first turned in place, and its direction from the first one turned."""

    def damaged(views: Views, random: torch.Generator) -> Views:
        assert views.cam_from_world is not None
        count = views.cam_from_world.shape[1]
        in_place, around = (_rotations(count, angle_deg, random) for _ in range(2))
        world_from_cam = invert_rigid(views.cam_from_world[0])
        centers = (around @ world_from_cam[:, :3, 3:])[..., 0]
        turned = invert_rigid(rigid(world_from_cam[:, :3, :3] @ in_place, centers))
        return replace(views, cam_from_world=turned[None])

    return damaged


def chain(*damages: Damage) -> Damage:
    """One after the other."""

    def damaged(views: Views, random: torch.Generator) -> Views:
        for damage in damages:
            views = damage(views, random)
        return views

    return damaged


KINDS: dict[str, Damage | None] = {
    "photos alone": None,
    "true": chain(),
    "drift of 3 %": drift(0.03),
    "drift of 10 %": drift(0.1),
    "edges blurred by 1 pixel": smooth(1),
    "edges blurred by 2 pixels": smooth(2),
    "noise of 5 %": noise(0.05),
    "noise of 10 %": noise(0.10),
    "noise of 15 %": noise(0.15),
    "cameras 1 degree off": turn(1),
    "cameras 2 degrees off": turn(2),
    "cameras 3 degrees off": turn(3),
    "drift 3 %, blur 1 pixel, noise 5 %, 1 degree": chain(
        drift(0.03), smooth(1), noise(0.05), turn(1)
    ),
}
"""None shows the model the photos and nothing else."""


def main(options: Options) -> None:
    """Prints a Markdown table."""
    torch.set_num_threads(options.threads)
    source = RoomDataset(options.data)
    indices = range(min(options.rooms, len(source)))
    tokenizer = load_model(options.model)
    print("| given | PSNR | AP50 | rotation (deg) | depth (rel) |\n|---|---|---|---|---|")
    for kind, damage in KINDS.items():
        given: list[Views] = []  # of the samples of the scene at hand, in their order

        def scenes(
            damage: Damage | None = damage, given: list[Views] = given
        ) -> Iterator[ProtocolScene]:
            random = torch.Generator().manual_seed(options.seed)
            for scene in protocol_rooms(source, indices, options.protocol):
                if damage is not None:
                    given[:] = [damage(sample.context, random) for sample in scene.samples]
                yield scene

        def model(photos: Views, given: list[Views] = given) -> TokenGroups:
            return tokenizer(given.pop(0) if given else photos)

        figures = evaluate(
            model, scenes(), EvaluationSettings(refine=options.refine),
            protocol=options.protocol, model_name=kind,
        ).figures  # fmt: skip
        print(
            f"| {kind} | {figures.psnr:.2f} | {figures.ap50:.3f} | {figures.rotation_deg:.2f} | "
            f"{figures.depth_rel:.3f} |",
            flush=True,
        )


def _depths(views: Views) -> Float[Tensor, "1 view height width"]:
    assert views.depths is not None
    return views.depths


def _rotations(
    count: int, angle_deg: float, random: torch.Generator
) -> Float[Tensor, "{count} 3 3"]:
    """About random axes; none for the first."""
    axes = functional.normalize(torch.randn(count, 3, generator=random), dim=-1)
    half = torch.full((count, 1), 0.5 * math.radians(angle_deg))
    half[0] = 0
    return quat_to_matrix(torch.cat([half.cos(), axes * half.sin()], dim=-1))


if __name__ == "__main__":
    main(tyro.cli(Options))
