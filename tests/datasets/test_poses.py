import numpy as np

from instok3d.datasets.poses import NO_POSE, NOT_RIGID, pose_fault


def test_only_rigid_finite_poses_are_sound():
    turned = np.array([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])
    assert pose_fault(turned) is None
    assert pose_fault(np.full((4, 4), np.nan)) == NO_POSE
    assert pose_fault(np.full((4, 4), -np.inf)) == NO_POSE
    assert pose_fault(np.zeros((4, 4))) == NOT_RIGID
    assert pose_fault(np.diag([2.0, 2.0, 2.0, 1.0])) == NOT_RIGID
    assert pose_fault(np.diag([1.0, 1.0, -1.0, 1.0])) == NOT_RIGID
    assert pose_fault(turned + np.eye(4)[3]) == NOT_RIGID
    far = turned.copy()
    far[0, 3] = 1e30
    assert pose_fault(far) == NOT_RIGID
