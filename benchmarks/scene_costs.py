"""What a scene costs as photos, anchors or groups become more: time, memory, Gaussians, groups.

    python benchmarks/scene_costs.py [--plot FILE.png]

Photos: the default model on those of the demo, repeated beyond eight. Anchors and groups: models of
other sizes with random weights on four of them, one window, where time and memory do not depend on
what was learned. Seconds are those of the processor for the backbone and for everything after
it, one thread, the middle one of --repeats calls.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from known_rows import known_or_measured
from panels import Panel, draw_panels
from torch import Tensor

from instok3d.backbones.nano.backbone import NanoBackbone
from instok3d.backbones.nano.network import NanoConfig
from instok3d.evaluation.peak_memory import peak_memory
from instok3d.model.files import load_model
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.photos.loading import read_photos
from instok3d.scene.demo import demo_photos
from instok3d.scene.reconstruct import IMAGE_SIDE
from instok3d.types import Geometry, Views


@dataclass(frozen=True)
class Options:
    """What to measure."""

    views: tuple[int, ...] = (2, 4, 8, 16)
    anchors: tuple[int, ...] = (256, 512, 1024, 1536)
    groups: tuple[int, ...] = (10, 40, 100, 200)
    repeats: int = 3
    plot: Path | None = None
    """A PNG of the curves."""
    known: tuple[Path, ...] = field(default=())
    """What was printed before; it is plotted, and not measured again."""


@dataclass(frozen=True)
class Row:
    """The cost at one size."""

    what: str
    """Of which there are `count`: photos, anchors or groups."""
    count: int
    geometry_s: float
    tokens_s: float
    peak_mb: float | None
    """Of the process; None where the system does not say."""
    gaussians: int
    groups_used: int
    """That win at least one anchor."""


def main(options: Options) -> None:
    """Prints a JSON object for each row as soon as it is there."""
    torch.set_num_threads(1)
    rows = known_or_measured(options.known, Row, measured(options))
    if options.plot is not None:
        kinds = dict.fromkeys(row.what for row in rows)
        curves = {kind: [asdict(row) for row in rows if row.what == kind] for kind in kinds}
        names = ("geometry_s", "tokens_s", "peak_mb", "gaussians", "groups_used")
        draw_panels(curves, "count", [Panel(name) for name in names], options.plot)


def measured(options: Options) -> Iterator[Row]:
    """The rows, of photos first."""
    trained = load_model()
    with demo_photos() as folder:
        photos = read_photos(folder, height=IMAGE_SIDE, width=IMAGE_SIDE)
    images = photos.views.images
    for count in options.views:
        yield measure("photos", count, trained, shown(images, count), options.repeats)
    window = shown(images, 4)
    for count in options.anchors:
        yield measure("anchors", count, untrained(num_anchors=count), window, options.repeats)
    for count in options.groups:
        yield measure("groups", count, untrained(num_groups=count), window, options.repeats)


def untrained(**sizes: int) -> Tokenizer:
    """A model with random weights; sizes that are not given are the default model's."""
    torch.manual_seed(0)
    return Tokenizer(NanoBackbone(NanoConfig()), replace(TokenizerConfig(), **sizes)).eval()


def shown(images: Float[Tensor, "1 view 3 height width"], count: int) -> Views:
    """So many photos, the first ones; repeated where there are fewer."""
    return Views(images[:, [view % images.shape[1] for view in range(count)]])


def measure(what: str, count: int, model: Tokenizer, views: Views, repeats: int) -> Row:
    """One row; a call before the first one allocates."""
    with torch.no_grad():
        seen: Geometry = model.backbone(views)
        scene = model(views, seen)
        with peak_memory(torch.device("cpu")) as peak:
            model(views)
        geometry_s = middle(lambda: model.backbone(views), repeats)
        tokens_s = middle(lambda: model(views, seen), repeats)
    winners = scene.assignment[0].argmax(dim=-1)
    used = winners[winners < scene.assignment.shape[-1] - 1].unique()
    return Row(
        what, count, geometry_s, tokens_s, None if peak.bytes is None else peak.bytes / 1e6,
        scene.gaussians.means.shape[1], len(used),
    )  # fmt: skip


def middle(work: Callable[[], object], repeats: int) -> float:
    """The median of the processor seconds of some calls."""
    spent = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        spent.append(time.process_time() - begin)
    return statistics.median(spent)


if __name__ == "__main__":
    main(tyro.cli(Options))
