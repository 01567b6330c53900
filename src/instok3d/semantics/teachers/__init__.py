"""Teachers: the embedded one, LSeg, CLIP, SigLIP 2 and DINO."""

from instok3d.semantics.teachers.opening import FORMS, open_teacher

__all__ = ["FORMS", "open_teacher"]
