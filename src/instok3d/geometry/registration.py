"""Relative cameras from points and their matched pixels, and their composition over many views."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid, rigid
from instok3d.geometry.similarity import weighted_procrustes


def skew(points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The matrix that takes a vector to its cross product, points x vector."""
    x, y, z = points.unbind(-1)
    zero = torch.zeros_like(x)
    rows = [
        torch.stack([zero, -z, y], dim=-1),
        torch.stack([z, zero, -x], dim=-1),
        torch.stack([-y, x, zero], dim=-1),
    ]
    return torch.stack(rows, dim=-2)


def rigid_from_twist(twist: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 4 4"]:
    """The rigid transform of a small motion: rotation exp(w), translation v, for twist (v, w)."""
    rotation = torch.linalg.matrix_exp(skew(twist[..., 3:]))
    return rigid(rotation, twist[..., :3])


def _projection_jacobian(points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2 3"]:
    x, y, z = points.unbind(-1)
    zero, inverse = torch.zeros_like(z), 1 / z
    rows = [
        torch.stack([inverse, zero, -x * inverse**2], dim=-1),
        torch.stack([zero, inverse, -y * inverse**2], dim=-1),
    ]
    return torch.stack(rows, dim=-2)


@dataclass(frozen=True)
class MatchedPoints:
    """Points of one camera and their matches in another: one direction of a pair."""

    points: Float[Tensor, "batch point 3"]
    """In the frame of their own camera."""
    rays: Float[Tensor, "batch point 2"]
    """x/z, y/z of the match of each in the other camera's frame."""
    matched: Float[Tensor, "batch point 3"]
    """The other camera's surface point at that place, in the other camera's frame."""
    confidence: Float[Tensor, "batch point"]
    """Confidence of each match, used as its weight, >= 0."""


def register_pair(
    a: MatchedPoints, b: MatchedPoints, *, iterations: int = 8, inlier_radius: float = 0.02
) -> Float[Tensor, "batch 4 4"]:
    """b_from_a: the rigid transform under which each camera's points project onto their matches.

    It starts from the weighted Procrustes fit of points to matched points, which needs the
    depth of both cameras, and then minimises the robust (Cauchy) distance between the
    projections of the points and the matched rays in both directions by Gauss-Newton, where
    errors of depth count little. Not differentiable: the matches are trained directly.

    Args:
        a: Points of camera a as b sees them.
        b: Points of camera b as a sees them.
        iterations: Of Gauss-Newton.
        inlier_radius: Distance in x/z, y/z at which a match has lost half its weight.
    """
    with torch.no_grad():
        source = torch.cat([a.points, b.matched], dim=1)
        target = torch.cat([a.matched, b.points], dim=1)
        weights = torch.cat([a.confidence, b.confidence], dim=1)
        robust = weights
        b_from_a = rigid(*weighted_procrustes(source, target, robust))
        for _ in range(4):
            residual = (source @ b_from_a[:, :3, :3].mT + b_from_a[:, None, :3, 3]) - target
            relative = residual.norm(dim=-1) / target.norm(dim=-1).clamp_min(1e-6)
            robust = weights / (1 + (relative / 0.1) ** 2)
            b_from_a = rigid(*weighted_procrustes(source, target, robust))
        for _ in range(iterations):
            b_from_a = _gauss_newton_step(b_from_a, a, b, inlier_radius)
        return b_from_a


def _gauss_newton_step(
    b_from_a: Float[Tensor, "batch 4 4"],
    a: MatchedPoints,
    b: MatchedPoints,
    inlier_radius: float,
) -> Float[Tensor, "batch 4 4"]:
    rotation, translation = b_from_a[:, :3, :3], b_from_a[:, :3, 3]
    identity = torch.eye(3, dtype=a.points.dtype, device=a.points.device)

    seen_b = a.points @ rotation.mT + translation[:, None]
    motion_b = torch.cat([identity.expand(*seen_b.shape[:2], 3, 3), -skew(seen_b)], dim=-1)
    seen_a = (b.points - translation[:, None]) @ rotation
    motion_a = torch.cat([identity.expand(*b.points.shape[:2], 3, 3), -skew(b.points)], dim=-1)
    motion_a = -(rotation.mT[:, None] @ motion_a)
    hessian_b, gradient_b = _equations_one_way(seen_b, a, motion_b, inlier_radius)
    hessian_a, gradient_a = _equations_one_way(seen_a, b, motion_a, inlier_radius)
    hessian = hessian_a + hessian_b
    damping = 1e-4 * hessian.diagonal(dim1=-2, dim2=-1).mean(-1).clamp_min(1e-6)
    hessian = hessian + damping[:, None, None] * torch.eye(6).to(hessian)
    twist = -torch.linalg.solve(hessian, gradient_a + gradient_b).squeeze(-1)
    # A step of more than 30 degrees or one unit of depth is a sign of too few matches: shorten it.
    twist = twist / (twist.norm(dim=-1, keepdim=True) / 0.5).clamp_min(1.0)
    return rigid_from_twist(twist) @ b_from_a


def _equations_one_way(
    seen: Float[Tensor, "batch point 3"],
    way: MatchedPoints,
    motion: Float[Tensor, "batch point 3 6"],
    inlier_radius: float,
) -> tuple[Float[Tensor, "batch 6 6"], Float[Tensor, "batch 6 1"]]:
    """Hessian and gradient over the twist, of the points that one camera sees of the other.

    Args:
        seen: The points, in the frame of the camera that sees them.
        way: Where that camera sees them.
        motion: Derivative of seen by the twist.
        inlier_radius: As in `register_pair`.
    """
    front = seen[..., 2] > 0.05
    safe = torch.where(front[..., None], seen, torch.ones_like(seen))
    residual = safe[..., :2] / safe[..., 2:] - way.rays
    robust = way.confidence * front / (1 + (residual.square().sum(-1) / inlier_radius**2))
    jacobian = _projection_jacobian(safe) @ motion
    flat = (jacobian * robust[..., None, None]).flatten(1, 2)
    return flat.mT @ jacobian.flatten(1, 2), (flat.mT @ residual.flatten(1)[..., None])


def spanning_tree(scores: Float[Tensor, "view view"]) -> list[tuple[int, int]]:
    """Edges (parent, child) of the maximum spanning tree rooted at view 0, parents first.

    Prim's algorithm: each step joins the view that has the best-scored link to the tree.
    """
    count = scores.shape[0]
    symmetric = torch.maximum(scores, scores.mT)
    inside, edges = [0], []
    while len(inside) < count:
        outside = [view for view in range(count) if view not in inside]
        block = symmetric[inside][:, outside]
        best = int(block.argmax())
        parent, child = inside[best // len(outside)], outside[best % len(outside)]
        edges.append((parent, child))
        inside.append(child)
    return edges


def best_loops(
    scores: Float[Tensor, "view view"], tree: list[tuple[int, int]], most: int
) -> list[tuple[int, int]]:
    """At most so many pairs that are not in the tree, best scores first."""
    count = scores.shape[0]
    symmetric = torch.maximum(scores, scores.mT)
    taken = {frozenset(edge) for edge in tree}
    pairs = [(a, b) for a in range(count) for b in range(a + 1, count)]
    open_pairs = [pair for pair in pairs if frozenset(pair) not in taken]
    return sorted(open_pairs, key=lambda pair: -float(symmetric[pair]))[:most]


def compose_along_tree(
    child_from_parent: dict[tuple[int, int], Float[Tensor, "4 4"]], edges: list[tuple[int, int]]
) -> Float[Tensor, "view 4 4"]:
    """cam_from_first of every view from relative cameras along the edges of a tree.

    Args:
        child_from_parent: For every edge (parent, child), or its reverse, the transform
            between the two cameras: key (a, b) holds b_from_a.
        edges: As spanning_tree gives them.
    """
    first = next(iter(child_from_parent.values())) if child_from_parent else torch.zeros(4, 4)
    cameras = {0: torch.eye(4, dtype=first.dtype, device=first.device)}
    for parent, child in edges:
        if (parent, child) in child_from_parent:
            step = child_from_parent[parent, child]
        else:
            step = invert_rigid(child_from_parent[child, parent])
        cameras[child] = step @ cameras[parent]
    return torch.stack([cameras[view] for view in range(len(cameras))])
