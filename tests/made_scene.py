"""A small scene made by hand."""

from dataclasses import replace

import torch

from instok3d.photos.pixel_map import fit_pixels
from instok3d.scene.from_tokens import bare_scene, with_objects
from instok3d.scene.record import Provenance, SceneView
from instok3d.scene.scene import Scene
from instok3d.scene.semantics import SceneSemantics, scene_semantics
from instok3d.semantics.tokens import SemanticTokens
from instok3d.types import Anchors, Cameras, Gaussians, Geometry, TokenGroups

HEIGHT, WIDTH = 24, 32
PER_ANCHOR = 4


def made_tokens(num_views: int = 2, num_groups: int = 4, sh_count: int = 4) -> TokenGroups:
    """A red blob of group 0 to the left, a blue one of group 2 to the right, void behind both.

    Group 1 wins no anchor. Group 3 wins one anchor that hides behind the first camera, so that
    no pixel shows it. World = first camera; the others step to the right.
    """
    generator = torch.Generator().manual_seed(3)
    places = torch.tensor([[-0.6, 0, 2.0], [0.6, 0, 2.0], [0, 0, 4.0], [0, 0, -2.0]])
    owners = torch.tensor([0, 0, 0, 2, 2, 4, 4, 4, 4, 3])
    kind = torch.tensor([0, 0, 0, 1, 1, 2, 2, 2, 2, 3])
    num_anchors = len(owners)
    positions = places[kind] + 0.1 * torch.randn(num_anchors, 3, generator=generator)
    positions[5:9, :2] += torch.tensor([[-1.0, -1], [1, -1], [-1, 1], [1, 1]])
    spread = torch.where(kind == 2, 0.9, 0.18).repeat_interleave(PER_ANCHOR)
    count = num_anchors * PER_ANCHOR
    jitter = 0.05 * torch.randn(count, 3, generator=generator)
    sh = torch.zeros(count, sh_count, 3)
    color = torch.tensor([[1.0, -1, -1], [-1, -1, 1], [0, 0, 0], [-1, 1, -1]])
    sh[:, 0] = color[kind].repeat_interleave(PER_ANCHOR, 0)
    sh[:, 1:] = 0.2 * torch.randn(count, sh_count - 1, 3, generator=generator)
    gaussians = Gaussians(
        means=positions.repeat_interleave(PER_ANCHOR, 0) + jitter,
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1),
        scales=spread[:, None] * (0.6 + 0.4 * torch.rand(count, 3, generator=generator)),
        opacities=0.5 + 0.4 * torch.rand(count, generator=generator),
        sh=sh,
        anchor_index=torch.arange(num_anchors).repeat_interleave(PER_ANCHOR),
    )
    # The owner has logit 4, every other group 0; the void's is 0 too, unless it is the owner.
    columns = torch.where(owners == 4, num_groups, owners)
    assignment = (4.0 * torch.nn.functional.one_hot(columns, num_groups + 1)).softmax(-1)
    intrinsics = torch.tensor(
        [[WIDTH / 1.2, 0, WIDTH / 2], [0, WIDTH / 1.2, HEIGHT / 2], [0, 0, 1]]
    )
    cam_from_world = torch.eye(4).repeat(num_views, 1, 1)
    cam_from_world[:, 0, 3] = -0.1 * torch.arange(num_views)
    depths = torch.full((1, num_views, HEIGHT, WIDTH), 2.0)
    batch = {name: value[None] for name, value in vars(gaussians).items()}
    return TokenGroups(
        anchors=Anchors(
            positions[None],
            torch.randn(1, num_anchors, 8, generator=generator),
            torch.arange(num_anchors)[None],
        ),
        tokens=torch.randn(1, num_groups, 8, generator=generator),
        assignment=assignment[None],
        gaussians=Gaussians(**batch),
        geometry=Geometry(
            features=torch.zeros(1, num_views, 12, 8),
            depths=depths,
            pointmaps=torch.zeros(1, num_views, HEIGHT, WIDTH, 3),
            confidences=torch.ones_like(depths),
            cameras=Cameras(cam_from_world[None], intrinsics.expand(1, num_views, 3, 3)),
        ),
    )


def made_scene(tokens: TokenGroups, **options) -> Scene:
    num_views = tokens.geometry.depths.shape[1]
    generator = torch.Generator().manual_seed(4)
    shape = (num_views, HEIGHT, WIDTH, 3)
    bare = bare_scene(
        tokens,
        torch.randint(0, 256, shape, generator=generator).to(torch.uint8),
        [
            SceneView(f"photo{index}.jpg", f"{index:064x}", fit_pixels(48, 66, HEIGHT, WIDTH))
            for index in range(num_views)
        ],
        provenance=Provenance("instok3d 0", "made by hand", "0" * 64, seed=0),
        **options,
    )
    return with_objects(replace(bare, semantics={"made-3": made_semantics(bare)}))


def made_semantics(scene: Scene, basis: int = 2) -> SceneSemantics:
    """Features of three channels, each group's around a value of its own, to compare and carry."""
    groups, anchors = len(scene.tokens.groups), len(scene.tokens.positions)
    generator = torch.Generator().manual_seed(5)
    shared = torch.nn.functional.one_hot(torch.arange(groups) % 3, 3).float()[:, None]
    tokens = SemanticTokens(
        (shared + 0.1 * torch.randn(groups, basis, 3, generator=generator))[None],
        torch.randn(1, anchors, 2, generator=generator),
        torch.rand(1, anchors, basis, generator=generator).softmax(-1),
        torch.randn(3, 2, generator=generator),
    )
    return scene_semantics(tokens)


def made_empty_scene() -> Scene:
    """One view; the void takes every anchor."""
    tokens = made_tokens(num_views=1)
    void = torch.zeros_like(tokens.assignment)
    void[..., -1] = 1
    return made_scene(replace(tokens, assignment=void))
