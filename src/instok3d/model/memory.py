"""How much memory a model will take, from its sizes alone: asked before anything is loaded.

The figures count the tensors that are alive at the worst moment of each part and were then held
against measured peaks (docs/models.md): never below, at most a quarter above.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import torch

from instok3d.backbones.base import BackboneConfig, GeometryBackbone
from instok3d.backbones.cost import FLOAT, Activations, Outline, Work, geometry_bytes
from instok3d.backbones.registry import build_backbone, kind_of
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
SCENE_BYTES = 500
"""A pixel of a photo: id maps, previews and the heap's gaps behind a tokenizer."""
LOADING = 2.1
"""While weights are loaded they are there twice: in the model and as they were read."""
MOST_VIEWS = 512
"""Larger counts are not looked for."""


def predict_peak_bytes(
    backbone: BackboneConfig, tokenizer: TokenizerConfig | None, work: Work
) -> int:
    """Most memory that a command holds at once when it does this with models of these sizes.

    For the CPU, with what Python and the libraries take; nothing is loaded or computed.

    Args:
        backbone: Config of a registered backbone.
        tokenizer: Sizes of the tokenizer behind it; None for a backbone alone.
        work: How many views of which size, in which type, and whether it is to learn.

    Raises:
        ValueError: The backbone is of no registered kind.
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
    backbone: BackboneConfig, tokenizer: TokenizerConfig | None, work: Work, limit_bytes: int
) -> int:
    """Most views of a scene with which this work is predicted to fit; 0 if not even one does."""
    return _most_views(
        lambda views: predict_peak_bytes(backbone, tokenizer, replace(work, views=views)),
        limit_bytes,
    )


def _most_views(needed: Callable[[int], int], limit_bytes: int) -> int:
    low, high = 0, 1
    while high <= MOST_VIEWS and needed(high) <= limit_bytes:
        low, high = high, 2 * high
    high = min(high, MOST_VIEWS + 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if needed(middle) <= limit_bytes else (low, middle)
    return low


def check_memory(
    backbone: BackboneConfig,
    tokenizer: TokenizerConfig | None,
    work: Work,
    *,
    device: str | torch.device = "cpu",
    advice: str = "take fewer views",
    first: tuple[BackboneConfig, Work] | None = None,
) -> int:
    """Refuse work that is predicted not to fit; gives the prediction, bytes.

    Where the system does not say what is free, nothing is refused.

    Args:
        backbone: Config of a registered backbone.
        tokenizer: Sizes of the tokenizer; None for a backbone alone.
        work: What is to be done.
        device: Where.
        advice: What the user can do about the number of views.
        first: Another backbone that runs before, beside the weights of the model, and is gone when
            the model runs; it sees the same number of views.

    Raises:
        NotEnoughMemoryError: Says what is needed, what is there and how many views would fit.
    """

    def of_model(views: int) -> int:
        return predict_peak_bytes(backbone, tokenizer, replace(work, views=views))

    def of_first(views: int) -> int:
        if first is None:
            return 0
        weights = FLOAT * count_parameters(backbone, tokenizer)[0]
        return weights + predict_peak_bytes(first[0], None, replace(first[1], views=views))

    def of_both(views: int) -> int:
        return max(of_model(views), of_first(views))

    needed = of_both(work.views)
    asked = first[1] if first is not None and of_first(work.views) == needed else work

    def remedy(limit: int) -> str:
        fitting = _most_views(of_both, limit)
        if not fitting:
            return "not even one view would fit: use a machine with more"
        return f"{fitting} view{'s' if fitting > 1 else ''} would fit: {advice}"

    what = f"{work.views} views of {asked.height} x {asked.width} pixels"
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
def count_parameters(
    backbone: BackboneConfig, tokenizer: TokenizerConfig | None
) -> tuple[int, int]:
    """Numbers in the whole model and in all but its backbone; no memory is taken for them."""
    network = _outline(backbone)
    if tokenizer is None:
        return network.numbers, 0
    with on_paper():
        behind = Tokenizer(_Stand(network), tokenizer)
    own = sum(parameter.numel() for parameter in behind.parameters())
    return network.numbers + own, own


class _Stand(GeometryBackbone):
    """Stands in for a backbone where a tokenizer is counted."""

    def __init__(self, outline: Outline) -> None:
        super().__init__()
        self.patch_size, self.feature_channels = outline.patch_size, outline.feature_channels

    def forward(self, views: Views) -> Geometry:
        raise NotImplementedError("what stands in for a backbone cannot be run")


@lru_cache
def _outline(backbone: BackboneConfig) -> Outline:
    kind = kind_of(backbone)
    if kind.outline is not None:
        return kind.outline(backbone)
    with on_paper():
        network = build_backbone(backbone)
    numbers = sum(parameter.numel() for parameter in network.parameters())
    return Outline(numbers, network.patch_size, network.feature_channels)


def backbone_activations(config: BackboneConfig, work: Work) -> Activations:
    """What a backbone holds while it runs; of one that does not say, its result alone.

    That is said in a warning: the work may then need more than is predicted.
    """
    kind = kind_of(config)
    if kind.activations is not None:
        return kind.activations(config, work)
    warnings.warn(
        f"how much memory a {kind.backbone.__name__} takes while it runs is not known (its kind is "
        "registered without activations): what is predicted leaves that out",
        stacklevel=2,
    )
    outline = _outline(config)
    features = FLOAT * work.pixels // outline.patch_size**2 * outline.feature_channels
    return Activations(peak=0, stored=0, result=features + geometry_bytes(work))


def tokenizer_activations(
    backbone: BackboneConfig, config: TokenizerConfig, work: Work
) -> Activations:
    """What the tokenizer holds while it runs, in one go or window by window."""
    size = config.window_views
    if not size or work.views <= size:
        return _tokens_at_once(backbone, config, work)
    window = _tokens_at_once(backbone, config, replace(work, views=size, batch=1))
    lengths = window_lengths(work.views, size) * work.batch
    patches = work.pixels // _outline(backbone).patch_size ** 2
    anchors = sum(lengths) * patches // (work.views * work.batch)
    kept = FLOAT * anchors * (config.width + 2 * config.num_groups)
    joining = 4 * FLOAT * patches * config.num_groups
    scene = work.views * work.batch * window.result // size
    return Activations(
        peak=window.peak + kept + joining + scene,
        stored=sum(lengths) * window.stored // size + joining,
        result=scene,
    )


def _tokens_at_once(backbone: BackboneConfig, config: TokenizerConfig, work: Work) -> Activations:
    """By the patch, by the anchor, by the Gaussian."""
    network = _outline(backbone)
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
