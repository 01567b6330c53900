"""How much memory a model will take, from its sizes alone: asked before anything is loaded.

The figures count the tensors that are alive at the worst moment of each part and were then held
against measured peaks (docs/models.md): never below, at most a quarter above.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import torch

from instok3d.backbones.base import GeometryBackbone
from instok3d.backbones.depth_anything3 import PATCH as DA3_PATCH
from instok3d.backbones.depth_anything3 import SIZES as DA3_SIZES
from instok3d.backbones.depth_anything3 import DepthAnything3Config
from instok3d.backbones.nano.backbone import NanoConfig
from instok3d.backbones.nano.matching import MATCH_STRIDE
from instok3d.backbones.registry import build_backbone
from instok3d.backbones.vggt.config import VGGTConfig
from instok3d.backbones.vggt.dense_head import IMAGES_AT_ONCE
from instok3d.errors import NotEnoughMemoryError
from instok3d.model.available_memory import available_bytes, resident_bytes
from instok3d.model.on_paper import on_paper
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.model.views.windows import window_lengths
from instok3d.types import Geometry, Views

PROCESS_BYTES = 300_000_000
"""Python, torch and the other libraries of a command, with what they allocate once (CPU only)."""
LEARNING_BYTES = 100_000_000
"""What training allocates once, beyond the tensors that are counted."""
CONVOLUTIONS_BYTES = 60_000_000
"""What the library of convolutions keeps for those of the dense heads."""
SCENE_BYTES = 500
"""A pixel of a photo: id maps, previews and the heap's gaps behind a tokenizer."""
LOADING = 2.1
"""While weights are loaded they are there twice: in the model and as they were read."""
DEPTH_ANYTHING_3 = {"tiny": 684_991, "small": 34_299_463, "base": 135_366_599}
"""Numbers in its networks."""
MOST_VIEWS = 512
"""Larger counts are not looked for."""
FLOAT = 4


@dataclass(frozen=True)
class Work:
    """What a model is to do at once."""

    views: int
    """Of each scene."""
    height: int
    """Of a view, pixels."""
    width: int
    dtype: torch.dtype = torch.float32
    """Of autocast; weights stay in float32."""
    batch: int = 1
    """Scenes at once."""
    training: bool = False
    """Whether values are kept for the gradient, and gradients and moments for the optimizer."""
    frozen_backbone: bool = True
    """Training: whether the backbone learns nothing."""
    targets: int = 1
    """Training: views of each scene that are rendered."""
    lpips: bool = False
    """Training: whether renders are also compared by LPIPS, with VGG16."""
    cached_geometry: bool = False
    """Training: whether the backbone's answers are read from a disk, and it is not loaded."""

    @property
    def pixels(self) -> int:
        """Of all views of all scenes."""
        return self.batch * self.views * self.height * self.width

    @property
    def narrow(self) -> int:
        """Bytes of a number that a linear layer puts out."""
        return self.dtype.itemsize


@dataclass(frozen=True)
class Activations:
    """Bytes of values on their way through one part of a model."""

    peak: int
    """At the worst moment, when nothing is kept for a gradient."""
    stored: int
    """Kept for the gradient."""
    result: int
    """What the part hands on."""


def predict_peak_bytes(backbone: Any, tokenizer: TokenizerConfig | None, work: Work) -> int:
    """Most memory that a command holds at once when it does this with models of these sizes.

    For the CPU, with what Python and the libraries take; nothing is loaded or computed.

    Args:
        backbone: Config of a registered backbone.
        tokenizer: Sizes of the tokenizer behind it; None for a backbone alone.
        work: How many views of which size, in which type, and whether it is to learn.

    Raises:
        ValueError: The backbone is of no kind that is known here.
    """
    whole, own = count_parameters(backbone, tokenizer)
    parts = [backbone_activations(backbone, work)]
    if work.cached_geometry:
        whole, parts = own, [Activations(0, 0, parts[0].result)]
    if tokenizer is not None:
        parts.append(tokenizer_activations(backbone, tokenizer, work))
    weights = FLOAT * whole
    if work.dtype != torch.float32:
        weights += work.narrow * whole  # autocast keeps narrow copies of the weights
    running = weights + sum(part.result for part in parts) + max(part.peak for part in parts)
    if work.training:
        trained = own if work.frozen_backbone and tokenizer is not None else whole
        running += 4 * FLOAT * trained  # gradient, two moments, running average
        learning = parts[1:] if work.frozen_backbone else parts
        running += sum(part.stored for part in learning) + _rendering(tokenizer, work)
        running += LEARNING_BYTES
    elif tokenizer is not None:
        running += SCENE_BYTES * work.pixels
    return PROCESS_BYTES + int(max(LOADING * FLOAT * whole, running))


def largest_view_count(
    backbone: Any, tokenizer: TokenizerConfig | None, work: Work, limit_bytes: int
) -> int:
    """Most views of a scene with which this work is predicted to fit; 0 if not even one does."""

    def fits(views: int) -> bool:
        asked = Work(**{**vars(work), "views": views})
        return predict_peak_bytes(backbone, tokenizer, asked) <= limit_bytes

    low, high = 0, 1
    while high <= MOST_VIEWS and fits(high):
        low, high = high, 2 * high
    high = min(high, MOST_VIEWS + 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def check_memory(
    backbone: Any,
    tokenizer: TokenizerConfig | None,
    work: Work,
    *,
    device: str | torch.device = "cpu",
    advice: str = "take fewer views",
) -> int:
    """Refuse work that is predicted not to fit; gives the prediction, bytes.

    Where the system does not say what is free, nothing is refused.

    Args:
        backbone: Config of a registered backbone.
        tokenizer: Sizes of the tokenizer; None for a backbone alone.
        work: What is to be done.
        device: Where.
        advice: What the user can do about the number of views.

    Raises:
        NotEnoughMemoryError: Says what is needed, what is there and how many views would fit.
    """
    needed = predict_peak_bytes(backbone, tokenizer, work)

    def remedy(limit: int) -> str:
        fitting = largest_view_count(backbone, tokenizer, work, limit)
        if not fitting:
            return "not even one view would fit: use a machine with more"
        return f"{fitting} view{'s' if fitting > 1 else ''} would fit: {advice}"

    what = f"{work.views} views of {work.height} x {work.width} pixels"
    if work.batch > 1:
        what += f" of {work.batch} scenes at once"
    refuse_beyond(needed, what=what, device=device, remedy=remedy)
    return needed


def refuse_beyond(
    needed: int, *, what: str, device: str | torch.device, remedy: Callable[[int], str]
) -> None:
    """Refuse what needs more memory than there is; nothing where the system does not say.

    Args:
        needed: Predicted peak, bytes.
        what: What needs it, plural.
        device: Where.
        remedy: What to do instead with so many bytes.

    Raises:
        NotEnoughMemoryError: Says what is needed and what is there.
    """
    free = available_bytes(device)
    if free is None:
        return
    # What this process has already is not asked for again.
    limit = free + (resident_bytes() if torch.device(device).type == "cpu" else PROCESS_BYTES)
    if needed > limit:
        raise NotEnoughMemoryError(
            f"{what} are predicted to need {needed / 1e9:.2f} GB on {device}, and "
            f"{limit / 1e9:.2f} GB are there; {remedy(limit)}"
        )


@lru_cache
def count_parameters(backbone: Any, tokenizer: TokenizerConfig | None) -> tuple[int, int]:
    """Numbers in the whole model and in all but its backbone; no memory is taken for them."""
    network = _on_paper(backbone)
    if tokenizer is None:
        return network.numbers, 0
    with on_paper():
        behind = Tokenizer(_Outline(network), tokenizer)
    own = sum(parameter.numel() for parameter in behind.parameters())
    return network.numbers + own, own


class _Paper(NamedTuple):
    """What is asked of a backbone."""

    numbers: int
    """Parameters."""
    patch_size: int
    feature_channels: int


class _Outline(GeometryBackbone):
    """Stands in for a backbone where a tokenizer is counted."""

    def __init__(self, paper: _Paper) -> None:
        super().__init__()
        self.patch_size, self.feature_channels = paper.patch_size, paper.feature_channels

    def forward(self, views: Views) -> Geometry:
        raise NotImplementedError("an outline of a backbone cannot be run")


@lru_cache
def _on_paper(backbone: Any) -> _Paper:
    if isinstance(backbone, DepthAnything3Config):
        # Its package cannot be built without weights.
        numbers = DEPTH_ANYTHING_3[backbone.size]
        return _Paper(numbers, DA3_PATCH, DA3_SIZES[backbone.size].width)
    with on_paper():
        network = build_backbone(backbone)
    numbers = sum(parameter.numel() for parameter in network.parameters())
    return _Paper(numbers, network.patch_size, network.feature_channels)


def backbone_activations(config: Any, work: Work) -> Activations:
    """What a backbone holds while it runs.

    Raises:
        ValueError: The backbone is of no kind that is known here.
    """
    for kind, count in _BACKBONES.items():
        if isinstance(config, kind):
            return count(config, work)
    raise ValueError(
        f"the memory of a {type(config).__name__} backbone cannot be predicted: "
        f"model.memory knows {', '.join(kind.__name__ for kind in _BACKBONES)}"
    )


def _nano(config: NanoConfig, work: Work) -> Activations:
    """Stem and depth head by the pixel, blocks by the token, matching by pairs of cells."""
    tokens = work.pixels // 64
    values = FLOAT * tokens * config.width
    cells = (work.height // MATCH_STRIDE) * (work.width // MATCH_STRIDE)
    matching = 3 * FLOAT * work.batch * cells**2 if work.views > 1 else 0
    result = 2 * values + _geometry(work) + FLOAT * work.pixels // MATCH_STRIDE**2 * 64
    block = (18 * FLOAT + 16 * work.narrow) * tokens * config.width
    return Activations(
        peak=480 * work.pixels + max(14 * values, matching),
        stored=1_000 * work.pixels + 2 * config.layers * block,
        result=result,
    )


def _vggt(config: VGGTConfig, work: Work) -> Activations:
    """Trunk by the token; dense heads by the pixel of the images that they decode at once."""
    patches = (work.height // config.patch_size) * (work.width // config.patch_size)
    special = 1 + config.num_register_tokens + config.intrinsics_token
    tokens = work.batch * work.views * (patches + special)
    values = FLOAT * tokens * config.embed_dim
    kept = 2 * len({*config.dpt_layers, config.depth - 1}) * values
    at_once = min(work.batch * work.views, IMAGES_AT_ONCE) * work.height * work.width
    dense = CONVOLUTIONS_BYTES + at_once * FLOAT * (3 * config.dpt_features // 2 + 64)
    block = (20 * FLOAT + 14 * work.narrow) * tokens * config.embed_dim
    blocks = config.dino_depth + 2 * config.depth
    every_image = work.pixels * FLOAT * (6 * config.dpt_features // 2 + 128)
    return Activations(
        peak=26 * values + kept + dense,
        stored=(blocks * values + block if config.checkpoint_blocks else blocks * block)
        + kept
        + 2 * every_image,
        result=2 * values + _geometry(work),
    )


def _depth_anything_3(config: DepthAnything3Config, work: Work) -> Activations:
    """As VGGT, with two maps out of its one dense head: depth and rays."""
    sizes = DA3_SIZES[config.size]
    tokens = work.batch * work.views * ((work.height // DA3_PATCH) * (work.width // DA3_PATCH) + 1)
    values = FLOAT * tokens * sizes.width
    kept = 2 * len(sizes.outputs) * values
    at_once = min(work.batch * work.views, IMAGES_AT_ONCE) * work.height * work.width
    every_image = work.pixels * FLOAT * (12 * sizes.dense_width // 2 + 256)
    block = (20 * FLOAT + 14 * work.narrow) * tokens * sizes.width
    return Activations(
        peak=26 * values
        + kept
        + CONVOLUTIONS_BYTES
        + at_once * FLOAT * (2 * sizes.dense_width + 32),
        stored=sizes.layers * block + kept + every_image,
        result=values + _geometry(work),
    )


_BACKBONES: dict[type, Callable[[Any, Work], Activations]] = {
    NanoConfig: _nano,
    VGGTConfig: _vggt,
    DepthAnything3Config: _depth_anything_3,
}


def tokenizer_activations(backbone: Any, config: TokenizerConfig, work: Work) -> Activations:
    """What the tokenizer holds while it runs, in one go or window by window."""
    size = config.window_views
    if not size or work.views <= size:
        return _tokens_at_once(backbone, config, work)
    window = _tokens_at_once(backbone, config, replace(work, views=size, batch=1))
    lengths = window_lengths(work.views, size) * work.batch
    patches = work.pixels // _on_paper(backbone).patch_size ** 2
    anchors = sum(lengths) * patches // (work.views * work.batch)
    kept = FLOAT * anchors * (config.width + 2 * config.num_groups)
    joining = 4 * FLOAT * patches * config.num_groups
    scene = work.views * work.batch * window.result // size
    return Activations(
        peak=window.peak + kept + joining + scene,
        stored=sum(lengths) * window.stored // size + joining,
        result=scene,
    )


def _tokens_at_once(backbone: Any, config: TokenizerConfig, work: Work) -> Activations:
    """By the patch, by the anchor, by the Gaussian."""
    network = _on_paper(backbone)
    channels, patches = network.feature_channels, work.pixels // network.patch_size**2
    anchors = min(work.batch * config.num_anchors, patches)
    head = config.gaussian_head
    numbers = 11 + 3 * head.coefficients
    gaussians = anchors * head.gaussians_per_anchor
    fusing = 100 * work.pixels + FLOAT * patches * (2 * channels + 5 * config.width)
    tokens = FLOAT * config.width * (5 * patches + 12 * anchors)
    decoding = FLOAT * gaussians * numbers * 6 + 2 * FLOAT * anchors * config.num_anchors
    layers = config.anchor_layers * (4 * patches + 24 * anchors) + config.group_layers * (
        4 * anchors + 24 * work.batch * config.num_groups
    )
    return Activations(
        peak=max(fusing, tokens, decoding),
        stored=fusing + FLOAT * config.width * layers + 2 * decoding,
        result=FLOAT * (gaussians * numbers + anchors * (config.width + config.num_groups)),
    )


def _rendering(tokenizer: TokenizerConfig | None, work: Work) -> int:
    """Renders with their features and gradients; LPIPS keeps 25 maps of the image a photo."""
    channels = 5 + (tokenizer.num_groups if tokenizer else 0)
    pixels = work.batch * work.targets * work.height * work.width
    return pixels * FLOAT * (4 * channels + (2 * 450 if work.lpips else 0))


def _geometry(work: Work) -> int:
    """Depths, confidences and pointmaps, as they are put together."""
    return work.pixels * FLOAT * 12
