"""Semantic tokens as a part of a scene: they follow its groups and anchors through every edit."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from instok3d.semantics.tokens import SemanticTokens
from instok3d.types import Flow

ENCODER = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
"""Names of encoders, which are names of files too."""


@dataclass(frozen=True)
class SceneSemantics(Flow):
    """What a scene stores of the features of one 2D encoder (Sec. 3.3).

    The numbers are those that float16 can hold, as which they are stored. A shared feature of
    zeros is that of a group of which the encoder knows nothing.
    """

    shared: Float[Tensor, "group basis feature"]
    """s of each group; the row is the object's id - 1."""
    residuals: Float[Tensor, "anchor residual"]
    """r."""
    mixing: Float[Tensor, "anchor basis"]
    """How much each anchor has of each shared feature of its group; rows sum to 1."""
    residual_map: Float[Tensor, "feature residual"]
    """W_r; of the encoder's model, the same for all scenes."""

    @property
    def num_scalars(self) -> int:
        """Numbers that are stored for this scene; W_r is the model's and does not count."""
        return self.batched().num_scalars

    def batched(self) -> SemanticTokens:
        """As tokens of a batch of one scene."""
        return SemanticTokens(
            self.shared[None], self.residuals[None], self.mixing[None], self.residual_map
        )

    def of_groups(
        self, assignment: Float[Tensor, "anchor column"]
    ) -> Float[Tensor, "group feature"]:
        """One feature for each group: the mean of what its anchors have of its shared ones.

        Args:
            assignment: pi of the scene, a column for each group and the void's last.
        """
        groups, basis = self.shared.shape[:2]
        shares = self.shared.new_zeros(groups + 1, basis)
        shares.index_add_(0, assignment.argmax(dim=1), self.mixing)
        mass = shares[:groups].sum(dim=1, keepdim=True)
        # A group without anchors has as much of each; with one shared feature a share is 1.
        means = torch.where(mass > 0, shares[:groups] / mass, 1 / basis)
        return torch.einsum("gk,gkd->gd", means, self.shared)

    def of_objects(
        self, ids: Sequence[int], assignment: Float[Tensor, "anchor column"]
    ) -> Float[Tensor, "object feature"]:
        """A unit vector for each object; zeros for one of which nothing is known."""
        rows = torch.tensor([number - 1 for number in ids], dtype=torch.long)
        return functional.normalize(self.of_groups(assignment)[rows], dim=1)


NO_SEMANTICS: Mapping[str, SceneSemantics] = MappingProxyType({})
"""Of a scene that no encoder saw. Else semantics by the name of the encoder."""


def scene_semantics(tokens: SemanticTokens) -> SceneSemantics:
    """The stored form of the tokens of a batch of one.

    Raises:
        ValueError: A batch of more than one scene, or numbers that are not finite.
    """
    if len(tokens.shared) != 1:
        raise ValueError(f"a scene is made of a batch of one, got {len(tokens.shared)}")
    found = SceneSemantics(
        tokens.shared[0], tokens.residuals[0], tokens.mixing[0], tokens.residual_map
    ).map(lambda value: value.detach().half().float().cpu())
    for name, value in vars(found).items():
        if not value.isfinite().all():
            raise ValueError(f"the semantic model gave {name} that are not finite")
    return found


def check_encoder(name: str) -> str:
    """The name of an encoder, if it is one.

    Raises:
        ValueError: It is none.
    """
    if not ENCODER.fullmatch(name):
        raise ValueError(
            f"{name[:80]!r} is no name of an encoder: small letters, digits, '.', '_' and '-'"
        )
    return name


def each(
    semantics: Mapping[str, SceneSemantics],
    operation: Callable[[SceneSemantics], SceneSemantics],
) -> Mapping[str, SceneSemantics]:
    """The semantics of every encoder after an operation."""
    return {name: operation(one) for name, one in semantics.items()}


def with_anchors(
    semantics: Mapping[str, SceneSemantics], index: Int[Tensor, " row"]
) -> Mapping[str, SceneSemantics]:
    """Semantics of the anchors of these numbers, in this order; one may come twice."""
    return each(
        semantics,
        lambda one: replace(one, residuals=one.residuals[index], mixing=one.mixing[index]),
    )


def with_group_like(
    semantics: Mapping[str, SceneSemantics], group: int | None
) -> Mapping[str, SceneSemantics]:
    """Semantics with one more group, whose features are another one's; None: of nothing known."""

    def longer(one: SceneSemantics) -> SceneSemantics:
        row = one.shared.new_zeros(1, *one.shared.shape[1:])
        if group is not None:
            row = one.shared[group : group + 1]
        return replace(one, shared=torch.cat([one.shared, row]))

    return each(semantics, longer)


def of_part(
    semantics: Mapping[str, SceneSemantics], group: int, anchors: Int[Tensor, " row"]
) -> Mapping[str, SceneSemantics]:
    """Semantics of one group, now the only one, and of some anchors."""
    return each(
        with_anchors(semantics, anchors),
        lambda one: replace(one, shared=one.shared[group : group + 1]),
    )


def with_part(
    semantics: Mapping[str, SceneSemantics], part: Mapping[str, SceneSemantics], num_anchors: int
) -> Mapping[str, SceneSemantics]:
    """Semantics with one more group and its anchors.

    An encoder that did not see the part's scene knows nothing of the part; what encoders say that
    did not see this scene goes.

    Args:
        semantics: Of the scene.
        part: Of the part: one group.
        num_anchors: Of the part.
    """
    joined = {}
    for name, one in semantics.items():
        more = part.get(name)
        if more is None or not torch.equal(more.residual_map, one.residual_map):
            more = _nothing(one, num_anchors)
        joined[name] = SceneSemantics(
            torch.cat([one.shared, more.shared]),
            torch.cat([one.residuals, more.residuals]),
            torch.cat([one.mixing, more.mixing]),
            one.residual_map,
        )
    return joined


def merged(
    semantics: Mapping[str, SceneSemantics],
    groups: Mapping[int, float],
    assignment: Float[Tensor, "anchor column"],
) -> Mapping[str, SceneSemantics]:
    """Semantics in which the first of some groups has the mean features of all of them.

    Several shared features of a group have no order: those of the other groups are first put into
    the one in which they are most alike the first group's, and what their anchors have of them too.

    Args:
        semantics: Of the scene.
        groups: Their weights. Groups of which nothing is known do not count.
        assignment: pi of the scene, a column for each group and the void's last.
    """
    rows = torch.tensor([*groups])
    weights = torch.tensor([*groups.values()], dtype=torch.float32)

    def averaged(one: SceneSemantics) -> SceneSemantics:
        one = _in_order_of_first(one, [*groups], assignment.argmax(dim=1))
        own = one.shared[rows]
        counted = weights * own.flatten(1).any(dim=1)
        mean = (counted[:, None, None] * own).sum(dim=0) / counted.sum().clamp_min(1e-9)
        shared = one.shared.clone()
        shared[rows[0]] = mean.half().float()
        return replace(one, shared=shared)

    return each(semantics, averaged)


def _in_order_of_first(
    one: SceneSemantics, groups: Sequence[int], owners: Int[Tensor, " anchor"]
) -> SceneSemantics:
    """Shared features of groups in the order in which they are most alike the first group's."""
    if one.shared.shape[1] == 1:
        return one
    # Imported here: it takes a fifth of a second, and only merges need it.
    from scipy.optimize import linear_sum_assignment

    shared, mixing = one.shared.clone(), one.mixing.clone()
    directions = functional.normalize(one.shared[list(groups)], dim=2)
    for group, own in zip(groups[1:], directions[1:], strict=True):
        alike = directions[0] @ own.T
        order = torch.from_numpy(linear_sum_assignment(alike.numpy(), maximize=True)[1])
        shared[group] = one.shared[group, order]
        mixing[owners == group] = one.mixing[owners == group][:, order]
    return replace(one, shared=shared, mixing=mixing)


def _nothing(like: SceneSemantics, num_anchors: int) -> SceneSemantics:
    """Semantics of one group of which nothing is known."""
    basis = like.mixing.shape[1]
    return SceneSemantics(
        like.shared.new_zeros(1, *like.shared.shape[1:]),
        like.residuals.new_zeros(num_anchors, like.residuals.shape[1]),
        like.mixing.new_full((num_anchors, basis), 1 / basis),
        like.residual_map,
    )
