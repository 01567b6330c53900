"""The tables as data: a new row is one entry here."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from instok3d.baselines.context_masks import MaskSource, Tracker, tracker_for
from instok3d.baselines.registry import MethodName
from instok3d.evaluation.semantic_lifting import ANCHOR, BOTH, ENCODER, GAUSSIANS, GROUP, PIXELS
from instok3d.evaluation.tokenizer_method import GeometryMode
from instok3d.tables.trainings import (
    BROKEN,
    C3G,
    JOINT,
    LSM,
    NO_ANCHOR_LOSS,
    NO_PROJECTION,
    NO_SELF_ATTENTION,
    NO_WARMUP,
    OURS,
    RE10K,
    RE10K_C3G,
    SEQUENTIAL,
    UNI3R,
    TablesOf,
)

Views = Literal[2, 8]
RoomKind = Literal["test", "held-out furniture", "held-out materials", "held-out room type",
                   "captures"]  # fmt: skip
"""Test rooms; transfer rooms by what of them no training room has; captures of real rooms."""
ROOM_KINDS: tuple[RoomKind, ...] = get_args(RoomKind)
SceneKind = RoomKind | Literal["RealEstate10K", "MipNeRF360"]
"""Those of rooms; where the tables are made of ScanNet 'test' are its test scenes."""
OWN = "own features"
"""Those that a model of one pass gives its Gaussians, in the place of a kind that is lifted."""


@dataclass(frozen=True)
class Tokenizer:
    """A tokenizer as the method of a row."""

    training: str
    """See `trainings`."""
    geometry: GeometryMode = "predicted"
    refine: int = 0
    """Steps of refinement on the context photos."""
    changed: tuple[tuple[str, int], ...] = ()
    """Settings of `TokenizerConfig` that differ from those of the training."""


@dataclass(frozen=True)
class PerScene:
    """A method that optimises each scene."""

    method: MethodName
    masks: MaskSource | None = None
    tracker: Tracker | None = None


@dataclass(frozen=True)
class OnePass:
    """A model of one pass that gives each Gaussian a feature and knows no instances."""

    training: str
    geometry: GeometryMode = "predicted"


@dataclass(frozen=True)
class Column:
    """A figure of the cells."""

    key: str
    """Name in the cell of the views or, as one of FEATURE_KEYS, in that of the features."""
    title: str
    decimals: int = 3
    better: Literal["up", "down", ""] = "up"
    """Which direction is better; the best row is bold."""


@dataclass(frozen=True)
class Row:
    """A method in a table."""

    label: str
    method: Tokenizer | PerScene | OnePass | None = None
    """Whose pictures and masks are measured; None where the row has none by its nature."""
    features: str | None = None
    """One of `semantic_lifting.KINDS`, lifted into the scenes of OURS; OWN of a model that has
    features; None for a row without."""
    scenes: SceneKind = "test"
    short: str = ""
    """Over its column of a figure; empty where the label is short enough."""
    kind: str = ""
    """First column of Table 2."""
    without: frozenset[str] = frozenset()
    """Columns that the method cannot have; any other figure that is missing is an error."""
    pictured: bool = True
    """Whether the figures have a column of it, as the paper's have of such a row."""
    compared: bool = True
    """With the others for what is best; not where it sees the photo that the others predict."""
    reference: bool = False
    """The others on the same scenes are compared with it one by one."""
    upper_bound: bool = False
    """Given more than a photo: not compared with the others for what is best."""


@dataclass(frozen=True)
class Table:
    """One table of the paper."""

    number: int
    title: str
    views: Views
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


PICTURES = (Column("psnr", "PSNR", 2), Column("ssim", "SSIM"), Column("lpips", "LPIPS", 3, "down"))
MASKS = (Column("ap", "AP"), Column("ap50", "AP50"), Column("ap25", "AP25"))
SOURCE = (Column("source_miou", "source mIoU"), Column("source_accuracy", "source acc."))
TARGET = (Column("target_miou", "target mIoU"), Column("target_accuracy", "target acc."))
FEATURE_KEYS = (*(column.key for column in (*SOURCE, *TARGET)), "stored")
NO_MASKS = frozenset(column.key for column in MASKS)
NO_LPIPS = "lpips"
"""The column that is left out where no weights of LPIPS are given."""

WITH_IDS = frozenset(ROOM_KINDS) - {"captures"}
"""Scenes whose instances are known."""
REFINED_STEPS = 100
"""As `reconstruct` does by default."""

_PER_SCENE: tuple[tuple[str, str, MethodName, str], ...] = (
    ("Gaussian Grouping", "Gaussian Grouping", "gaussian-grouping", "per-scene optimization"),
    ("ObjectGS", "ObjectGS", "objectgs", "per-scene optimization"),
    ("mask-regularised 3DGS + label lifting", "label lifting", "label-lifting",
     "feed-forward + optimization"),
)  # fmt: skip


def tables(
    masks: Sequence[MaskSource], tracker: Tracker | None = None, of: TablesOf = "rooms"
) -> dict[int, Table]:
    """The paper's six tables, and two of our own deviations.

    Args:
        masks: That methods are given in Table 2, a row for each.
        tracker: How ids of masks that are not true come to hold across views; None is the rule
            for each source (`context_masks.tracker_for`).
        of: Of rooms, methods of one pass see photos alone. Of ScanNet they are told the true
            intrinsics, as in the paper, and Tables 5 and 6 are of RealEstate10K and MipNeRF360.
    """
    geometry: GeometryMode = "predicted" if of == "rooms" else "intrinsics"
    joint = Tokenizer(JOINT, geometry)
    ours = Tokenizer(OURS, geometry)
    uni3r, c3g = OnePass(UNI3R, geometry), OnePass(C3G, geometry)
    cost = (
        Column("gaussians", "Gaussians", 0, ""),
        Column("semantic_units", "sem. units", 0, ""),
        Column("stored", "feature size", 0, ""),
    )
    per_scene = [
        _given_masks(source, tracker_for(source, tracker), *method, pictured=source == masks[0])
        for source in masks
        for method in _PER_SCENE
    ]
    kinds: tuple[SceneKind, ...] = ROOM_KINDS if of == "rooms" else ("MipNeRF360",)
    transfer = [
        Row(f"{label}, {kind}", method, scenes=kind, reference=method == ours,
            without=frozenset() if kind in WITH_IDS and method == ours else NO_MASKS)
        for kind in kinds
        for label, method in (("Uni3R style", uni3r), ("Ours", ours))
    ]  # fmt: skip
    broken_tracks = Table(5, "Training on simulated broken tracks, 2 context views", 2,
                          (*PICTURES, *MASKS), (
        Row("C3G style", c3g, without=NO_MASKS),
        Row("Ours, broken tracks", Tokenizer(BROKEN)),
        Row("Ours, true tracks", joint, upper_bound=True, reference=True),
    ))  # fmt: skip
    sam_tracks = Table(5, "Training on RealEstate10K with masks of SAM 2, 2 context views", 2,
                       PICTURES, (
        Row("C3G style", OnePass(RE10K_C3G, geometry), scenes="RealEstate10K"),
        Row("Ours", Tokenizer(RE10K, geometry), scenes="RealEstate10K", reference=True),
    ))  # fmt: skip
    each = (
        Table(1, "Reconstruction and feature lifting with 2 context views", 2,
              (*SOURCE, *TARGET, *PICTURES, *cost), (
            Row("2D encoder (LSeg's place)", features=ENCODER, pictured=False, compared=False,
                without=frozenset({"stored"})),
            Row("LSM style", OnePass(LSM, geometry), OWN),
            Row("Uni3R style", uni3r, OWN),
            Row("C3G style", c3g, OWN),
            Row("one feature per pixel, our scenes", features=PIXELS, pictured=False),
            Row("one feature per Gaussian, our scenes", features=GAUSSIANS, pictured=False),
            Row("Ours", ours, features=BOTH, reference=True),
        )),
        Table(2, "Class-agnostic instances and reconstruction with 8 context views", 8,
              (*MASKS, *PICTURES), (
            Row("3DGS", PerScene("3dgs"), kind="per-scene optimization", without=NO_MASKS,
                pictured=False),
            *per_scene,
            Row("Ours, cameras and depth given", Tokenizer(OURS, "given"), kind="feed-forward",
                pictured=False, upper_bound=True),
            Row("Ours", ours, kind="feed-forward", reference=True),
            Row(f"Ours, refined in {REFINED_STEPS} steps", replace(ours, refine=REFINED_STEPS),
                kind="feed-forward + optimization", pictured=False),
        )),
        Table(3, "Joint reconstruction and grouping, 2 context views", 2, (*PICTURES, *MASKS), (
            Row("sequential", replace(joint, training=SEQUENTIAL)),
            Row("without warm-up", replace(joint, training=NO_WARMUP)),
            Row("Ours", joint, reference=True),
        )),
        Table(4, "Decomposed feature lifting, 2 context views", 2, TARGET, (
            Row("Anchor", features=ANCHOR),
            Row("Group", features=GROUP),
            Row("Group + Anchor", features=BOTH),
        )),
        broken_tracks if of == "rooms" else sam_tracks,
        Table(6, "Transfer without fine-tuning, 2 context views", 2,
              (*PICTURES, *MASKS) if of == "rooms" else PICTURES, tuple(transfer)),
        Table(7, "Own deviations, each left out of training, 2 context views", 2,
              (*PICTURES, *MASKS), (
            Row("Ours", joint, reference=True),
            Row("without the anchors' own loss", replace(joint, training=NO_ANCHOR_LOSS)),
            Row("without self-attention", replace(joint, training=NO_SELF_ATTENTION)),
            Row("without projections of the tokens", replace(joint, training=NO_PROJECTION)),
        )),
        Table(8, "Own deviations, each left out after training, 8 context views", 8,
              (*PICTURES, *MASKS), (
            Row("Ours", ours, reference=True),
            Row("all views at once, no windows", replace(ours, changed=(("window_views", 0),))),
            Row("free space not thinned", replace(ours, changed=(("thin_free_space", False),))),
        )),
    )  # fmt: skip
    return {table.number: table for table in each}


def _given_masks(
    source: MaskSource,
    tracker: Tracker,
    label: str,
    short: str,
    name: MethodName,
    kind: str,
    *,
    pictured: bool,
) -> Row:
    """A row of a method that optimises each scene with masks of its photos."""
    given = f"masks {source}" if source == "true" else f"masks {source}, tracker {tracker}"
    return Row(
        f"{label}, {given}",
        PerScene(name, source, tracker),
        short=short,
        kind=kind,
        pictured=pictured,
        upper_bound=source == "true",
    )


def without_lpips(table: Table) -> Table:
    """The table without the column that nobody can fill without weights of LPIPS."""
    columns = tuple(column for column in table.columns if column.key != NO_LPIPS)
    return replace(table, columns=columns)
