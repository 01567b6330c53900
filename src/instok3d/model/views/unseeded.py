"""Leaving out anchors where the depth of their patch is not to be relied on."""

from dataclasses import replace

from jaxtyping import Bool
from torch import Tensor

from instok3d.types import TokenGroups


def without_patches(groups: TokenGroups, patches: Bool[Tensor, " patch"]) -> TokenGroups:
    """The scene without the anchors that stand on some patches, and without their Gaussians.

    Groups and geometry stay as they are.

    Args:
        groups: A batch of one, as anchors left differ in number from scene to scene.
        patches: True where an anchor is left out, among the patches of all views.
    """
    kept = ~patches[groups.anchors.patches[0]]
    new_number = kept.cumsum(0) - 1
    gaussians = groups.gaussians.scene(0)
    gaussians = gaussians.rows(kept[gaussians.anchor_index])
    gaussians = replace(gaussians, anchor_index=new_number[gaussians.anchor_index])
    return replace(
        groups,
        anchors=groups.anchors.map(lambda values: values[:, kept]),
        assignment=groups.assignment[:, kept],
        gaussians=gaussians.batched(),
    )
