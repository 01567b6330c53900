"""Which camera poses of a data set can be used."""

import numpy as np
import torch
from jaxtyping import Float

from instok3d.geometry.checks import rigid_fault

NO_POSE = "a pose that is not finite"
NOT_RIGID = "a pose that is not rigid"
ROTATION_TOLERANCE = 0.02
"""Of ScanNet's and RealEstate10K's rotations, which are rounded more than own cameras may be."""


def pose_fault(pose: Float[np.ndarray, "4 4"]) -> str | None:
    """Why a frame with this pose is dropped; None where the pose is sound."""
    if not np.isfinite(pose).all():
        return NO_POSE
    return (
        None if rigid_fault(torch.tensor(pose), tolerance=ROTATION_TOLERANCE) is None else NOT_RIGID
    )
