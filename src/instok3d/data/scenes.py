"""What every data set offers: scenes by number, of which single frames can be read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from jaxtyping import Float, Int, UInt8
from torch import Tensor

from instok3d.data.words import ObjectWords


@dataclass(frozen=True)
class SceneFrames:
    """Some frames of one scene with what is known about them; OpenCV cameras."""

    name: str
    """Of the scene, unlike any other of its data set."""
    images: UInt8[Tensor, "frame height width 3"]
    """sRGB bytes."""
    instances: Int[Tensor, "frame height width"]
    """Ids, the same for the same thing in all frames; 0 = no instance, -1 = unlabelled."""
    depths_m: Float[Tensor, "frame height width"]
    """z-depth in the unit of the cameras, metres where that is known; 0 = unknown."""
    world_from_cam: Float[Tensor, "frame 4 4"]
    intrinsics: Float[Tensor, "frame 3 3"]
    """Pixels of these images."""
    words: Mapping[int, ObjectWords] = field(default_factory=dict)
    """Of instance ids of the scene, in these frames or not; empty where none are known."""


@runtime_checkable
class SceneSource(Protocol):
    """Scenes by number. Reading from several threads and processes must be safe."""

    def __len__(self) -> int: ...

    def name_of(self, number: int, /) -> str:
        """The name of scene `number`, by which runs know it; nothing of the scene is read."""
        ...

    def num_frames(self, number: int, /) -> int:
        """How many frames scene `number` has; nothing of the scene is read."""
        ...

    def frames(self, number: int, chosen: Sequence[int], /) -> SceneFrames:
        """These frames of scene `number` in this order; no others are read."""
        ...
