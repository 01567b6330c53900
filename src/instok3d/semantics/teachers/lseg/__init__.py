"""LSeg, written anew so that the published weights load."""

from instok3d.semantics.teachers.lseg.teacher import LSegTeacher, label_scores

__all__ = ["LSegTeacher", "label_scores"]
