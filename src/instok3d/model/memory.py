"""Prediction of the peak memory of a model from its sizes, before anything is loaded.

Each part counts the tensors that are alive at its peak. The predictions were compared with measured
peaks (docs/models.md): they are never below, and at most a quarter above.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import torch

from instok3d.backbones.base import BackboneConfig
from instok3d.backbones.cost import FLOAT, Activations, Outline, Work, geometry_bytes
from instok3d.backbones.registry import build_backbone, kind_of
from instok3d.errors import NotEnoughMemoryError
from instok3d.model.available_memory import available_bytes, resident_bytes
from instok3d.model.on_paper import StandIn, on_paper
from instok3d.model.tokenizer import Tokenizer, TokenizerConfig
from instok3d.model.views.windows import window_lengths

PROCESS_BYTES = 300_000_000
"""Python, torch and the other libraries of a command, with their own allocations (CPU only)."""
LEARNING_BYTES = 100_000_000
"""Allocations of training that do not grow with the work and are not counted elsewhere."""
SCENE_BYTES = 500
"""Per pixel of a photo: id maps, previews and fragmentation of the heap after a tokenizer."""
LOADING = 2.1
"""Copies of the weights while they are loaded: in the model and as read from the file."""
MOST_VIEWS = 512
"""Upper limit of the search for the largest number of views."""


def predict_peak_bytes(
    backbone: BackboneConfig, tokenizer: TokenizerConfig | None, work: Work
) -> int:
    """Predicted peak memory of a command that does this work with models of these sizes.

    For the CPU, including Python and the libraries. Nothing is loaded or computed.

    1. Weights, with narrow copies under autocast.
    2. Results of all parts, which are kept, and the largest peak of a part while it runs.
    3. In training: gradients, optimizer state, and the activations stored for the backward pass.
    4. The peak is the larger one of loading the weights and running.

    Args:
        backbone: Config of a registered backbone.
        tokenizer: Sizes of the tokenizer behind it; None for a backbone alone.
        work: Number and size of the views, type of the activations, and whether it trains.

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
        weights += work.narrow * whole  # copies that autocast keeps
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
    """Largest number of views of a scene that is predicted to fit; 0 if a single view does not."""
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
    """Predicted peak in bytes; refuses work that is predicted not to fit.

    Nothing is refused where the system does not report its free memory.

    Args:
        backbone: Config of a registered backbone.
        tokenizer: Sizes of the tokenizer; None for a backbone alone.
        work: The work to be done.
        device: Device that it runs on.
        advice: How the user can reduce the number of views.
        first: Another backbone that runs before, beside the weights of the model, and is gone when
            the model runs; it sees the same number of views.

    Raises:
        NotEnoughMemoryError: States what is needed, what is free and how many views would fit.
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
    """Raise an error for work that needs more memory than is free, if the system reports that.

    Args:
        needed: Predicted peak, bytes.
        what: Description of the work, in the plural.
        device: Device that it runs on.
        remedy: Gives advice for a limit in bytes.

    Raises:
        NotEnoughMemoryError: States what is needed and what is free.
    """
    free = available_bytes(device)
    if free is None:
        return
    # The prediction includes memory that this process already holds.
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
    """Parameters of the whole model, and of all but its backbone; allocates nothing for them."""
    network = _outline(backbone)
    if tokenizer is None:
        return network.numbers, 0
    with on_paper():
        behind = Tokenizer(StandIn(network), tokenizer)
    own = sum(parameter.numel() for parameter in behind.parameters())
    return network.numbers + own, own


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
    """Memory of a backbone while it runs.

    A kind that is registered without activations counts only with its result; a warning says that
    more may be needed than is predicted.
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
    """Memory of the tokenizer while it runs, on all views at once or window by window."""
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
    """Memory of the tokenizer on all views at once, counted per patch, anchor and Gaussian."""
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
    """Renders with features and gradients; LPIPS stores 450 values per pixel of each image."""
    channels = 5 + (tokenizer.num_groups if tokenizer else 0)
    pixels = work.batch * work.targets * work.height * work.width
    return pixels * FLOAT * (4 * channels + (2 * 450 if work.lpips else 0))
