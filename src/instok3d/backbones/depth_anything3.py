"""Depth Anything 3 as a geometry backbone; the only file that imports the package."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from instok3d.backbones.base import (
    BackboneConfig,
    GeometryBackbone,
    Prediction,
    settle_geometry,
)
from instok3d.backbones.cost import (
    CONVOLUTIONS_BYTES,
    FLOAT,
    Activations,
    Outline,
    Work,
    geometry_bytes,
)
from instok3d.backbones.vggt.dense_head import IMAGES_AT_ONCE
from instok3d.geometry.cameras import rigid
from instok3d.reading import reason_of
from instok3d.types import Geometry, Views
from instok3d.weights.reading import FETCH_AGAIN, read_weights_file

PATCH = 14
IMAGE_MEAN = (0.485, 0.456, 0.406)
IMAGE_STD = (0.229, 0.224, 0.225)
PUBLISHED = "model."
"""Before every name in a published file: the package's class around the network."""


@dataclass(frozen=True)
class _Sizes:
    """Sizes of one of the networks."""

    width: int
    heads: int
    layers: int
    outputs: tuple[int, int, int, int]
    """Layers that the dense head reads."""
    first_global: int
    """From here on every other block attends across views."""
    dense_width: int
    dense_channels: tuple[int, int, int, int]


SIZES = {
    "small": _Sizes(384, 6, 12, (5, 7, 9, 11), 4, 64, (48, 96, 192, 384)),
    "base": _Sizes(768, 12, 12, (5, 7, 9, 11), 4, 128, (96, 192, 384, 768)),
    "tiny": _Sizes(64, 2, 4, (0, 1, 2, 3), 2, 16, (8, 8, 16, 16)),
}
"""The two whose weights are Apache-2.0, and one for tests, of which there are no weights."""
NUMBERS = {"tiny": 684_991, "small": 34_299_463, "base": 135_366_599}
"""Parameters of each."""


@dataclass(frozen=True)
class DepthAnything3Config(BackboneConfig):
    """Which Depth Anything 3 it is."""

    size: Literal["small", "base", "tiny"] = "small"
    """34.3 M or 135.4 M parameters; "tiny" is for tests."""

    @property
    def image_side(self) -> int:
        """As its authors run it."""
        return 56 if self.size == "tiny" else 504


class DepthAnything3Backbone(GeometryBackbone):
    """Features, depth and cameras of Depth Anything 3 (arXiv 2511.10647).

    Features are the normalised patch tokens of the last block. What the views give stands in for
    the prediction; the network itself sees the photos alone. The first view is its reference. Its
    parts for given cameras and for rays are never asked, so they get no gradient.
    """

    patch_size = PATCH

    def __init__(self, config: DepthAnything3Config) -> None:
        super().__init__()
        self.config = config
        self.sizes = SIZES[config.size]
        self.feature_channels = self.sizes.width
        self.net = _new_network(self.sizes)

    def forward(self, views: Views) -> Geometry:
        """Geometry of the views, which holds what they give.

        May run under autocast, which the package turns off in its heads. Differentiable.

        Raises:
            ValueError: The image size is no multiple of 14.
        """
        images = views.images
        height, width = images.shape[-2:]
        if height % PATCH or width % PATCH:
            raise ValueError(
                f"images are {height}x{width} pixels; Depth Anything 3 needs multiples of "
                f"{PATCH}: resize or crop them"
            )
        mean, std = (images.new_tensor(each)[:, None, None] for each in (IMAGE_MEAN, IMAGE_STD))
        last = self.sizes.layers - 1
        # With any other reference the package returns the features of three and more views in
        # another order than the depths.
        output = self.net(
            (images - mean) / std, export_feat_layers=[last], ref_view_strategy="first"
        )
        with torch.autocast(images.device.type, enabled=False):
            cameras = output["extrinsics"].float()
            prediction = Prediction(
                features=output["aux"][f"feat_layer_{last}"].flatten(2, 3),
                depths=output["depth"].float(),
                confidences=output["depth_conf"].float(),
                cam_from_world=rigid(cameras[..., :3, :3], cameras[..., :3, 3]),
                intrinsics=output["intrinsics"].float(),
            )
            return settle_geometry(views, prediction)


def load_depth_anything3_weights(
    path: Path, config: DepthAnything3Config | None = None
) -> DepthAnything3Backbone:
    """A backbone with published weights, in eval mode on the CPU.

    Args:
        path: `model.safetensors` of DA3-SMALL or DA3-BASE.
        config: Which of them it is; small for None.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged, or holds other tensors than this network's.
    """
    backbone = DepthAnything3Backbone(config or DepthAnything3Config())
    if not path.is_file():
        raise FileNotFoundError(f"no weights {path}; give model.safetensors of Depth Anything 3")
    weights, _ = read_weights_file(path, FETCH_AGAIN)
    try:
        backbone.net.load_state_dict(from_published(weights))
    except RuntimeError as error:
        raise ValueError(
            f"{path} does not hold Depth Anything 3 {backbone.config.size}: {reason_of(error)}"
        ) from error
    return backbone.eval()


def is_installed() -> bool:
    """Whether the package is here, without importing it."""
    return find_spec("depth_anything_3") is not None


def is_published(state: Mapping[str, Tensor]) -> bool:
    """Whether these are weights under the published names, all of which begin with `model.`."""
    return bool(state) and all(name.startswith(PUBLISHED) for name in state)


def from_published(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The state dict of the package's network from published weights."""
    return {name.removeprefix(PUBLISHED): value for name, value in state.items()}


def fill_from_published(backbone: DepthAnything3Backbone, weights: Mapping[str, Tensor]) -> bool:
    """Put published weights into a backbone; False if these are none.

    Raises:
        RuntimeError: They are of another size.
    """
    if not is_published(weights):
        return False
    backbone.net.load_state_dict(from_published(weights))
    return True


def depth_anything3_outline(config: DepthAnything3Config) -> Outline:
    """Its sizes without building it, which the package cannot do without memory."""
    return Outline(NUMBERS[config.size], PATCH, SIZES[config.size].width)


def depth_anything3_activations(config: DepthAnything3Config, work: Work) -> Activations:
    """As VGGT, with two maps out of its one dense head: depth and rays."""
    sizes = SIZES[config.size]
    tokens = work.batch * work.views * ((work.height // PATCH) * (work.width // PATCH) + 1)
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
        result=values + geometry_bytes(work),
    )


class _Encoder(nn.Module):
    """The package's image encoder at sizes of one's own, with its names in the state dict."""

    def __init__(self, transformer: nn.Module, outputs: tuple[int, ...]) -> None:
        super().__init__()
        self.pretrained = transformer
        self.outputs = list(outputs)

    def forward(self, images: Any, **options: Any) -> Any:
        """What the package's own wrapper returns."""
        return self.pretrained.get_intermediate_layers(images, self.outputs, **options)  # pyright: ignore


def _new_network(sizes: _Sizes) -> nn.Module:
    """The package's network of these sizes, with random weights."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of how the package uses its own dependencies
            from depth_anything_3.model.cam_dec import CameraDec  # pyright: ignore
            from depth_anything_3.model.cam_enc import CameraEnc  # pyright: ignore
            from depth_anything_3.model.da3 import DepthAnything3Net  # pyright: ignore
            from depth_anything_3.model.dinov2.vision_transformer import (  # pyright: ignore
                DinoVisionTransformer,
            )
            from depth_anything_3.model.dualdpt import DualDPT  # pyright: ignore
            from depth_anything_3.utils.logger import logger  # pyright: ignore
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Depth Anything 3 needs a package that is not installed ({error.name}): "
            "pip install einops omegaconf addict && "
            "pip install --no-deps depth-anything-3==0.1.1",
            name=error.name,
        ) from error
    logger.level = 0  # errors only: the rest goes to standard output, which is for results
    transformer = DinoVisionTransformer(
        img_size=518,
        patch_size=PATCH,
        embed_dim=sizes.width,
        depth=sizes.layers,
        num_heads=sizes.heads,
        alt_start=sizes.first_global,
        qknorm_start=sizes.first_global,
        rope_start=sizes.first_global,
        cat_token=True,
    )
    return DepthAnything3Net(
        net=_Encoder(transformer, sizes.outputs),
        head=DualDPT(
            2 * sizes.width,
            output_dim=2,
            features=sizes.dense_width,
            out_channels=sizes.dense_channels,
        ),
        cam_dec=CameraDec(2 * sizes.width),
        cam_enc=CameraEnc(sizes.width),
    )
