"""The tables as data: a new row is one entry here."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from instok3d.baselines.context_masks import MaskSource, Tracker
from instok3d.baselines.registry import MethodName
from instok3d.evaluation.semantic_lifting import ANCHOR, BOTH, ENCODER, GAUSSIANS, GROUP, PIXELS
from instok3d.evaluation.tokenizer_method import GeometryMode
from instok3d.tables.trainings import BROKEN, JOINT, NO_WARMUP, OURS, SEQUENTIAL

Views = Literal[2, 8]
SceneKind = Literal["test", "held-out furniture", "held-out materials", "held-out room type",
                    "captures"]  # fmt: skip
"""Test rooms; transfer rooms by what of them no training room has; captures of real rooms."""
ROOM_KINDS: tuple[SceneKind, ...] = (
    "test", "held-out furniture", "held-out materials", "held-out room type"
)  # fmt: skip


@dataclass(frozen=True)
class Tokenizer:
    """A tokenizer as the method of a row."""

    training: str
    """See `trainings`."""
    geometry: GeometryMode = "predicted"
    refine: int = 0
    """Steps of refinement on the context photos."""


@dataclass(frozen=True)
class PerScene:
    """A method that optimises each scene."""

    method: MethodName
    masks: MaskSource | None = None
    tracker: Tracker | None = None


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
    method: Tokenizer | PerScene | None = None
    """Whose pictures and masks are measured; None where the row has none by its nature."""
    features: str | None = None
    """One of `semantic_lifting.KINDS`, lifted into the scenes of OURS; None for a row without."""
    scenes: SceneKind = "test"
    short: str = ""
    """Over its column of a figure; empty where the label is short enough."""
    kind: str = ""
    """First column of Table 2."""
    without: frozenset[str] = frozenset()
    """Columns that the method cannot have; any other figure that is missing is an error."""
    not_built: str = ""
    """Why there is no such method yet; such a row is named and never measured."""
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

_LATER = "the tables do not train it yet (instok3d train nano-uni3r-style and nano-c3g-style do)"
_SEGMENTER = "the tables do not train a segmenter yet (instok3d train nano-segmenter does)"
LSM, UNI3R, C3G = "LSM style", "Uni3R style", "C3G style"

_PER_SCENE: tuple[tuple[str, str, MethodName, str], ...] = (
    ("Gaussian Grouping", "GG", "gaussian-grouping", "per-scene optimization"),
    ("ObjectGS", "ObjectGS", "objectgs", "per-scene optimization"),
    ("mask-regularised 3DGS + label lifting", "lifting", "label-lifting",
     "feed-forward + optimization"),
)  # fmt: skip


def tables(masks: Sequence[MaskSource], tracker: Tracker) -> dict[int, Table]:
    """All six tables.

    Args:
        masks: That methods are given in Table 2, a row for each.
        tracker: How ids of masks that are not true come to hold across views.
    """
    joint = Tokenizer(JOINT)
    ours = Tokenizer(OURS)
    cost = (
        Column("gaussians", "Gaussians", 0, ""),
        Column("semantic_units", "sem. units", 0, ""),
        Column("stored", "feature size", 0, ""),
    )
    per_scene = tuple(
        Row(
            f"{label}, masks {source}" + ("" if source == "true" else f", tracker {tracker}"),
            PerScene(name, source, "true-ids" if source == "true" else tracker),
            short=f"{brief}, {source}",
            kind=kind,
            upper_bound=source == "true",
        )
        for source in masks
        for label, brief, name, kind in _PER_SCENE
    )
    transfer = [Row(f"Ours, {kind}", ours, scenes=kind) for kind in ROOM_KINDS]
    each = (
        Table(1, "Reconstruction and feature lifting with 2 context views", 2,
              (*SOURCE, *TARGET, *PICTURES, *cost), (
            Row("2D encoder (LSeg's place)", features=ENCODER, short="2D encoder",
                without=frozenset({"stored"})),
            Row(LSM, not_built=_LATER),
            Row(UNI3R, not_built=_LATER),
            Row(C3G, not_built=_LATER),
            Row("one feature per pixel, our scenes", features=PIXELS, short="per pixel"),
            Row("one feature per Gaussian, our scenes", features=GAUSSIANS, short="per Gaussian"),
            Row("Ours", ours, features=BOTH),
        )),
        Table(2, "Class-agnostic instances and reconstruction with 8 context views", 8,
              (*MASKS, *PICTURES), (
            Row("3DGS", PerScene("3dgs"), kind="per-scene optimization", without=NO_MASKS),
            *per_scene,
            Row("per-scene methods, masks segmenter", kind="per-scene optimization",
                not_built=_SEGMENTER),
            Row("Ours, cameras and depth given", Tokenizer(OURS, "given"), kind="feed-forward",
                short="Ours, given", upper_bound=True),
            Row("Ours", ours, kind="feed-forward"),
        )),
        Table(3, "Joint reconstruction and grouping, 2 context views", 2, (*PICTURES, *MASKS), (
            Row("sequential", Tokenizer(SEQUENTIAL)),
            Row("without warm-up", Tokenizer(NO_WARMUP)),
            Row("Ours", joint),
        )),
        Table(4, "Decomposed feature lifting, 2 context views", 2, TARGET, (
            Row("Anchor", features=ANCHOR),
            Row("Group", features=GROUP),
            Row("Group + Anchor", features=BOTH),
        )),
        Table(5, "Training on simulated broken tracks, 2 context views", 2, (*PICTURES, *MASKS), (
            Row(C3G, not_built=_LATER),
            Row("Ours, broken tracks", Tokenizer(BROKEN)),
            Row("Ours, true tracks", joint, upper_bound=True),
        )),
        Table(6, "Transfer without fine-tuning, 2 context views", 2, (*PICTURES, *MASKS), (
            Row(UNI3R, not_built=_LATER), *transfer,
            Row("Ours, captures", ours, scenes="captures", without=NO_MASKS),
        )),
    )  # fmt: skip
    return {table.number: table for table in each}


def without_lpips(table: Table) -> Table:
    """The table without the column that nobody can fill without weights of LPIPS."""
    columns = tuple(column for column in table.columns if column.key != NO_LPIPS)
    return replace(table, columns=columns)
