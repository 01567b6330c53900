"""Normal equations of bundle adjustment over cameras, depth corrections and focal length."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from instok3d.backbones.nano.bundle_errors import point_errors
from instok3d.backbones.nano.bundle_problem import NEAREST, BundleNoise, Observations
from instok3d.backbones.nano.native_kernels import required_kernels
from instok3d.backbones.nano.threads import all_threads
from instok3d.geometry.cameras import invert_rigid
from instok3d.geometry.registration import skew


@dataclass(frozen=True)
class NormalEquations:
    """Hessian and gradient over (twist, node corrections) of all views and the log focal length."""

    hessian: Float[Tensor, "batch view view part part"]
    gradient: Float[Tensor, "batch view part"]
    focal_hessian: Float[Tensor, " batch"]
    focal_gradient: Float[Tensor, " batch"]
    focal_cross: Float[Tensor, "batch view part"]
    """Hessian between the log focal length and the other unknowns."""


def normal_equations(
    observations: Observations,
    weights_here: Float[Tensor, "observation point node"],
    weights_there: Float[Tensor, "observation point node"],
    noise: BundleNoise,
    cameras: Float[Tensor, "batch view 4 4"],
    corrections: Float[Tensor, "batch view node"],
    log_focal: Float[Tensor, " batch"],
) -> NormalEquations:
    """Gauss-Newton equations of all residuals, without the priors; the kernels' reference.

    Args:
        observations: Points and rays, by the initial depths and focal length.
        weights_here: Node weights of the points in view here.
        weights_there: Node weights of their matches in view there.
        noise: Expected errors.
        cameras: Current cam_from_first.
        corrections: Current log-depth corrections at the nodes.
        log_focal: Logarithm of the current focal length over the initial one.
    """
    scenes, here, there = observations.scenes, observations.here, observations.there
    # 1. Residuals and derivatives of every point.
    there_from_here = cameras[scenes, there] @ invert_rigid(cameras[scenes, here])
    correction_here = (weights_here @ corrections[scenes, here, :, None])[..., 0]
    correction_there = (weights_there @ corrections[scenes, there, :, None])[..., 0]
    errors = point_errors(
        observations, there_from_here, correction_here, correction_there, log_focal[scenes], noise
    )
    twist, of_here, of_there = errors.by_twist, errors.by_depth_here, errors.by_depth_there
    of_focal = errors.by_focal

    # 2. Sums over the points of each observation, in the twist of camera there and the nodes of
    # both views.
    twists = twist.flatten(1, 2).mT @ twist.flatten(1, 2)
    cross_here = (twist * of_here[..., None]).sum(2).mT @ weights_here
    cross_there = (twist * of_there[..., None]).sum(2).mT @ weights_there
    with all_threads():  # most of the solver's work, large enough to share
        nodes_here = (weights_here * of_here.square().sum(-1)[..., None]).mT @ weights_here
        nodes_there = (weights_there * of_there.square().sum(-1)[..., None]).mT @ weights_there
        nodes_mixed = (weights_here * (of_here * of_there).sum(-1)[..., None]).mT @ weights_there
    twist_gradient = (twist * errors.values[..., None]).sum((1, 2))
    gradient_here = ((of_here * errors.values).sum(-1)[:, None] @ weights_here)[:, 0]
    gradient_there = ((of_there * errors.values).sum(-1)[:, None] @ weights_there)[:, 0]
    twist_focal = (twist * of_focal[..., None]).sum((1, 2))
    focal_here = ((of_here * of_focal).sum(-1)[:, None] @ weights_here)[:, 0]
    focal_there = ((of_there * of_focal).sum(-1)[:, None] @ weights_there)[:, 0]

    # 3. The same sums in the twist of camera here: a small motion of it changes the projection as
    # the opposite motion of camera there, expressed in the frame of there (adjoint).
    carry = -_adjoint(there_from_here)
    carried = carry.mT @ twists
    blocks_there = (twists, cross_there, cross_there.mT, nodes_there)
    blocks_here = (carried @ carry, carry.mT @ cross_here, cross_here.mT @ carry, nodes_here)
    mixed = (carried, carry.mT @ cross_there, cross_here.mT, nodes_mixed)
    mixed_transposed = (mixed[0].mT, mixed[2].mT, mixed[1].mT, mixed[3].mT)

    # 4. Add up the blocks of all observations.
    batch, count, parts_of_view = *cameras.shape[:2], 6 + corrections.shape[-1]
    hessian = twists.new_zeros(batch, count, count, parts_of_view, parts_of_view)
    gradient = twists.new_zeros(batch, count, parts_of_view)
    for a, b, blocks in (
        (there, there, blocks_there),
        (here, here, blocks_here),
        (here, there, mixed),
        (there, here, mixed_transposed),
    ):
        top, bottom = torch.cat(blocks[:2], dim=-1), torch.cat(blocks[2:], dim=-1)
        block = torch.cat([top, bottom], dim=-2)
        # Not index_put_: on several threads its order of summation varies.
        hessian.flatten(0, 2).index_add_(0, (scenes * count + a) * count + b, block)
    cross = torch.zeros_like(gradient)
    carried_gradient = (carry.mT @ twist_gradient[..., None])[..., 0]
    carried_focal = (carry.mT @ twist_focal[..., None])[..., 0]
    for view, parts, focal_parts in (
        (there, (twist_gradient, gradient_there), (twist_focal, focal_there)),
        (here, (carried_gradient, gradient_here), (carried_focal, focal_here)),
    ):
        row = scenes * count + view
        gradient.flatten(0, 1).index_add_(0, row, torch.cat(parts, dim=-1))
        cross.flatten(0, 1).index_add_(0, row, torch.cat(focal_parts, dim=-1))
    zero = gradient.new_zeros(len(cameras))
    return NormalEquations(
        hessian,
        gradient,
        zero.index_add(0, scenes, of_focal.square().sum((1, 2))),
        zero.index_add(0, scenes, (of_focal * errors.values).sum((1, 2))),
        cross,
    )


def native_equations(
    observations: Observations,
    grid: tuple[int, int],
    noise: BundleNoise,
    cameras: Float[Tensor, "batch view 4 4"],
    corrections: Float[Tensor, "batch view node"],
    log_focal: Float[Tensor, " batch"],
) -> NormalEquations:
    """`normal_equations` in C++, for float32 on the CPU.

    A point has weights at four nodes of each view alone, which products of dense matrices cannot
    use. Uses all threads, also inside of `one_thread`; their number does not change the result.

    Args:
        observations: As in `normal_equations`.
        grid: Rows and columns of nodes.
        noise: As in `normal_equations`.
        cameras: As in `normal_equations`.
        corrections: As in `normal_equations`.
        log_focal: As in `normal_equations`.

    Raises:
        RuntimeError: The kernels are not built.
        ValueError: A scene or view of the observations does not exist.
    """
    batch, count, nodes = corrections.shape
    parts = 6 + nodes
    found = NormalEquations(
        hessian=cameras.new_empty(batch, count, count, parts, parts),
        gradient=cameras.new_empty(batch, count, parts),
        focal_hessian=cameras.new_empty(batch),
        focal_gradient=cameras.new_empty(batch),
        focal_cross=cameras.new_empty(batch, count, parts),
    )
    given = observations
    with all_threads():
        required_kernels().bundle_equations(
            *(
                values.contiguous()
                for values in (
                    given.scenes, given.here, given.there, given.points, given.rays,
                    given.precision, given.depths, given.confidence, given.positions_here,
                    given.positions_there, cameras, corrections, log_focal,
                )
            ),
            found.hessian, found.gradient, found.focal_hessian, found.focal_gradient,
            found.focal_cross, rows=grid[0], columns=grid[1], nearest=NEAREST,
            independence=noise.independence, fine_depth=noise.fine_depth,
            mutual_depth=noise.mutual_depth, outlier=noise.outlier,
            threads=torch.get_num_threads(),
        )  # fmt: skip
    return found


def _adjoint(transform: Float[Tensor, "observation 4 4"]) -> Float[Tensor, "observation 6 6"]:
    """The matrix that takes a twist before the transform to the equal twist after it."""
    rotation, translation = transform[:, :3, :3], transform[:, :3, 3]
    top = torch.cat([rotation, skew(translation) @ rotation], dim=-1)
    bottom = torch.cat([torch.zeros_like(rotation), rotation], dim=-1)
    return torch.cat([top, bottom], dim=-2)
