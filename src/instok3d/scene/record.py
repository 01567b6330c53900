"""What a scene consists of, without anything that is done with it: what a scene folder holds."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from jaxtyping import Float, UInt8
from torch import Tensor

from instok3d.geometry.cameras import invert_rigid
from instok3d.photos.pixel_map import PixelMap
from instok3d.scene.objects import SceneObject
from instok3d.scene.semantics import NO_SEMANTICS, SceneSemantics
from instok3d.scene.vertical import Vertical
from instok3d.types import Cameras, Flow, Gaussians

NEAR, FAR = 0.02, 40.0
"""In typical distances: 5 cm and 100 m for a room 2.5 m deep."""


MAX_FAR = 1e12
"""Limit of near_far, scene units."""

Frame = Literal["first camera", "given cameras", "file"]


@dataclass(frozen=True)
class SceneView:
    """One photo that the scene was made from."""

    file: str
    """Name of the file, without its folder."""
    sha256: str
    """Of the file's bytes."""
    pixel_map: PixelMap
    """Between the photo's pixels and those of the view at the scene's size."""


@dataclass(frozen=True)
class SceneTokens(Flow):
    """The compact form of a scene: anchors, groups, and which group each anchor belongs to."""

    positions: Float[Tensor, "anchor 3"]
    """a, in the scene's world."""
    anchors: Float[Tensor, "anchor channel"]
    """A."""
    groups: Float[Tensor, "group channel"]
    """G."""
    assignment: Float[Tensor, "anchor group+1"]
    """pi; the last column is the void."""


@dataclass(frozen=True)
class RefinementRecord:
    """One optimisation of the Gaussians on the photos (`instok3d.refine`)."""

    steps: int
    """That were done."""
    height: int
    """Of the photos that the Gaussians were compared with, pixels."""
    width: int
    split_share: float
    """Share of the Gaussians that were split in two; 0 kept their number."""
    seed: int
    """Of the order of the views."""
    psnr_before: float
    """Of the renders at the photos' own cameras, dB."""
    psnr_after: float
    """Likewise, with the exposure fitted to each photo."""


@dataclass(frozen=True)
class CleanUpRecord:
    """How groups were made whole objects (`instok3d.scene.clean_up`)."""

    joined: int
    """Groups that became a part of another one."""
    moved: int
    """Gaussians that were given to another group."""


@dataclass(frozen=True)
class Provenance:
    """What a scene was made with."""

    generator: str
    """Program and version."""
    model: str
    """Name of the model."""
    model_sha256: str
    seed: int
    geometry: str = ""
    """Where cameras and depth come from: the name of a backbone, "given" for given cameras, or
    empty in scenes of older programs, which did not say."""
    geometry_sha256: str = ""
    """Of its weights; empty where they are the model's own or were in memory."""
    refinements: tuple[RefinementRecord, ...] = ()
    """In the order they were done; after one the tokens no longer give the Gaussians."""
    clean_up: CleanUpRecord | None = None
    """None where the groups are as the model gave them."""
    edits: tuple[str, ...] = ()
    """What was edited, in words, in the order it was done (`instok3d.scene.edits`)."""
    invented: int = 0
    """Gaussians that fills of removals added: no photo shows what they show."""
    edited_from: str = ""
    """SHA-256 of gaussians.safetensors of the scene before its first edit; empty without edits."""
    hub: str = ""
    """hub:USER/NAME@COMMIT that the scene was loaded from; empty for a folder of this machine."""

    @property
    def tokens_give_gaussians(self) -> bool:
        """Whether decoding the tokens again would give these Gaussians, of these anchors."""
        return not self.refinements and not (self.clean_up and self.clean_up.moved)


@dataclass(frozen=True, repr=False)
class SceneRecord:
    """The data of a scene; `Scene` adds what can be done with it.

    A scene that was imported from a file has no views, and tokens of no channels: one anchor for
    each object, which belongs to it with probability 1 (`scene.from_gaussians`).
    """

    gaussians: Gaussians
    """Unbatched, sorted by object in the order of `objects`; the rest comes last."""
    tokens: SceneTokens
    cameras: Cameras
    """Of the input views; intrinsics for pictures of the scene's height and width."""
    height: int
    """Of the input views as the model saw them, pixels; of a scene without views, of the pictures
    that are drawn unless another size is asked for."""
    width: int
    objects: tuple[SceneObject, ...]
    """By rising id."""
    views: tuple[SceneView, ...]
    photos: UInt8[Tensor, "view height width 3"]
    """The input views as the model saw them, sRGB."""
    units: Literal["metres", "arbitrary"]
    """Of all lengths."""
    frame: Frame
    """The world: OpenCV axes of the first view's camera, or that of the given cameras or of the
    file that the scene was imported from, whose axes are their own."""
    vertical: Vertical
    """Which way is up in it."""
    near_far: tuple[float, float]
    """z-depths between which Gaussians are drawn, scene units. Fixed when the scene is made:
    an edit does not change what is drawn of the rest."""
    warnings: tuple[str, ...]
    """What was left out, guessed or ignored on the way here."""
    provenance: Provenance
    semantics: Mapping[str, SceneSemantics] = field(default_factory=lambda: NO_SEMANTICS)
    """What 2D encoders say of groups and anchors, by the encoder's name."""

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} objects={len(self.objects)} "
            f"gaussians={len(self.gaussians.means)} views={len(self.views)} "
            f"size={self.height}x{self.width} units={self.units} warnings={len(self.warnings)}>"
        )


def near_and_far(gaussians: Gaussians, cameras: Cameras) -> tuple[float, float]:
    """z-depths between which the Gaussians of a new scene are drawn, scene units.

    Relative to the median distance of the Gaussians from the first camera, or from their own
    centre where there is no camera, since the units may be arbitrary.
    """
    if not len(gaussians.means):
        return NEAR, FAR
    if len(cameras.cam_from_world):
        center = invert_rigid(cameras.cam_from_world[0])[:3, 3]
    else:
        center = gaussians.means.median(dim=0).values
    typical = float((gaussians.means - center).norm(dim=1).median()) or 1.0
    return NEAR * typical, FAR * typical
