"""What questions need of an encoder: its texts and pictures, its classes, its calibration."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from instok3d.rooms.classes import STUFF
from instok3d.semantics.classes import PHRASES
from instok3d.semantics.query.calibration import Calibration
from instok3d.semantics.query.ranking import Vocabulary, vocabulary_of
from instok3d.semantics.teacher import Teacher


@dataclass(frozen=True)
class QueryEncoder:
    """An encoder with what makes its similarities readable."""

    teacher: Teacher
    calibration: Calibration = field(default_factory=Calibration)

    @cached_property
    def vocabulary(self) -> Vocabulary:
        """The classes of rooms in its space."""
        return vocabulary_of(PHRASES, STUFF, self.embed)

    def embed(self, texts: Sequence[str]) -> Float[Tensor, "text channel"]:
        """A unit vector for each text, on the CPU."""
        return functional.normalize(self.teacher.text(texts).float().cpu(), dim=1)

    def picture(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, " channel"]:
        """The unit vector of a picture of one thing, on the CPU."""
        return functional.normalize(self.teacher.crop(image).float().cpu(), dim=0)
