"""Which camera poses of a data set can be used."""

import numpy as np
from jaxtyping import Float

NO_POSE = "a pose that is not finite"
NOT_RIGID = "a pose that is not rigid"


def pose_fault(pose: Float[np.ndarray, "4 4"]) -> str | None:
    """Why a frame with this pose is dropped; None where the pose is sound."""
    if not np.isfinite(pose).all():
        return NO_POSE
    gram = pose[:3, :3].T @ pose[:3, :3]
    rigid = np.allclose(gram, np.eye(3), atol=0.02) and np.linalg.det(pose[:3, :3]) > 0
    return None if rigid and np.allclose(pose[3], [0, 0, 0, 1], atol=1e-4) else NOT_RIGID
