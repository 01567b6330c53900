"""The forward pass against minutes of optimisation: pictures and masks over processor time.

    python benchmarks/optimisation.py --data rooms-test [--rooms 5] [--masks true] [--plot FILE.png]

All methods see the same eight photos of the same test rooms with their cameras and depth, those
of others also masks; the first row of ours sees photos alone, its targets are placed by predicted
cameras. Seconds are those of the processor from the photos to the scene, the mean over rooms, in
one process on one thread. A method whose scenes are optimised is begun anew for each number of
steps, since its rates fall with the steps that are left.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
import tyro
from known_rows import known_or_measured
from panels import Panel, draw_panels

from instok3d.baselines.context_masks import MasksOf, MaskSource, Tracker, context_masks
from instok3d.baselines.registry import METHODS, MethodName
from instok3d.baselines.segmenter_file import load_segmenter
from instok3d.baselines.settings import SplatSettings
from instok3d.evaluation.methods import FittedScene, Method, Need, Shown
from instok3d.evaluation.protocols import TEST_SEEDS, protocol_rooms, room_indices
from instok3d.evaluation.run import EvaluationSettings, evaluate
from instok3d.evaluation.tokenizer_method import GeometryMode, TokenizerMethod
from instok3d.model.files import load_model
from instok3d.model.tokenizer import Tokenizer
from instok3d.rooms import RoomDataset
from instok3d.tables.kept_masks import kept_masks

NAMES: dict[MethodName, str] = {
    "3dgs": "3DGS", "gaussian-grouping": "Gaussian Grouping", "objectgs": "ObjectGS",
    "label-lifting": "label lifting",
}  # fmt: skip

MODES: dict[GeometryMode, str] = {"predicted": "ours, photos alone", "given": "ours, given"}


@dataclass(frozen=True)
class Options:
    """What to measure."""

    data: Path
    """Folder of the test rooms."""
    rooms: int = 5
    """The first so many."""
    methods: tuple[MethodName, ...] = ("3dgs", "objectgs", "gaussian-grouping")
    steps: tuple[int, ...] = (50, 100, 200, 400, 800)
    """Of the methods that optimise each scene."""
    refine: tuple[int, ...] = (0, 25, 50, 100, 200, 400)
    """Steps of refinement after our forward pass."""
    masks: MaskSource = "true"
    """That methods are given."""
    tracker: Tracker = "true-ids"
    segmenter: Path | None = None
    """For masks of a segmenter."""
    model: Path | None = None
    """A model file; None takes the default model."""
    plot: Path | None = None
    """A PNG of the curves."""
    known: tuple[Path, ...] = field(default=())
    """What was printed before; it is plotted too, and not measured again."""


@dataclass
class Timed:
    """A method, and the processor time of each scene that it makes."""

    method: Method
    seconds: list[float] = field(default_factory=list)

    @property
    def needs(self) -> frozenset[Need]:
        """Of the method."""
        return self.method.needs

    def fit(self, shown: Shown) -> FittedScene:
        """Its scene."""
        begin = time.process_time()
        scene = self.method.fit(shown)
        self.seconds.append(time.process_time() - begin)
        return scene


@dataclass(frozen=True)
class Row:
    """One method after some steps."""

    method: str
    steps: int
    seconds: float
    """Of the processor, for a scene."""
    gaussians: float
    psnr: float | None
    ap: float | None
    """None of a method that knows no instances."""
    ap50: float | None


def main(options: Options) -> None:
    """Prints a JSON object for each row as soon as it is there."""
    torch.set_num_threads(1)
    rows = known_or_measured(options.known, Row, measured(options))
    if options.plot is not None:
        plot(rows, options.plot)


def measured(options: Options) -> Iterator[Row]:
    """The rows, ours first."""
    tokenizer = load_model(options.model)
    first = replace(options, rooms=1)  # the first call allocates, and may compile kernels
    measure("", 1, Timed(TokenizerMethod(tokenizer, "predicted", 1)), "predicted", first)
    for steps in options.refine:
        for mode, name in MODES.items():
            yield measure(
                name, steps, Timed(TokenizerMethod(tokenizer, mode, steps)), mode, options
            )
    with TemporaryDirectory() as folder:
        masks_of = kept_masks(given_masks(options, tokenizer), Path(folder))
        for name in options.methods:
            for steps in options.steps:
                method = Timed(METHODS[name](SplatSettings(steps=steps)))
                yield measure(NAMES[name], steps, method, "given", options, masks_of)


def measure(
    name: str, steps: int, method: Timed, mode: GeometryMode, options: Options,
    masks_of: MasksOf | None = None,
) -> Row:  # fmt: skip
    """One row."""
    source = RoomDataset(options.data, TEST_SEEDS)
    indices = room_indices(
        [source.seed_of(number) for number in range(len(source))], num_scenes=options.rooms
    )
    figures = evaluate(
        method, protocol_rooms(source, indices, "rooms-8view"), EvaluationSettings(geometry=mode),
        protocol="rooms-8view", model_name=name, masks_of=masks_of,
    ).figures  # fmt: skip
    seconds = sum(method.seconds) / len(method.seconds)
    assert figures.gaussians is not None
    return Row(name, steps, seconds, figures.gaussians, figures.psnr, figures.ap, figures.ap50)


def given_masks(options: Options, tokenizer: Tokenizer) -> MasksOf:
    """Those of the context views."""
    segmenter = None if options.segmenter is None else load_segmenter(options.segmenter)
    segment = None if segmenter is None else segmenter.masks
    geometry_of = tokenizer.backbone
    return context_masks(options.masks, options.tracker, geometry_of=geometry_of, segment=segment)


def plot(rows: Sequence[Row], file: Path) -> None:
    """PSNR, AP and AP50 over seconds, a curve for each method."""
    curves = {name: [asdict(row) for row in rows if row.method == name]
              for name in dict.fromkeys(row.method for row in rows)}  # fmt: skip
    best = max(row.psnr or 0 for row in rows)
    panels = [Panel("psnr", (20, 5 * (best // 5 + 1))), Panel("ap", (0, 1)), Panel("ap50", (0, 1))]
    draw_panels(curves, "seconds", panels, file)


if __name__ == "__main__":
    main(tyro.cli(Options))
